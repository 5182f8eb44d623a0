"""The authority's folder, and the files that `tfbus keys` makes in it."""

import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests import needs
from tfbus import SettingsError, TfbusError
from tfbus.cli import main

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from cryptography.hazmat.primitives import serialization

from tfbus.bus.identity_folder import open_folder
from tfbus.bus.keystore import Keystore, write_private
from tfbus.bus.rights import Identity


@pytest.fixture
def store(tmp_path: Path) -> Keystore:
    store = Keystore.init(tmp_path / "keys", days=100)
    store.add(Identity("arm", "publisher", hosts=("arm.local", "10.0.0.7")), days=90)
    return store


def keys(store: Keystore, *arguments: str) -> tuple[int, str]:
    """The exit code and the output of `tfbus keys ARGUMENTS`."""
    result = CliRunner().invoke(main, ["keys", *arguments, "--keys", str(store.path)])
    return result.exit_code, result.output


@pytest.fixture
def open_umask() -> Iterator[None]:
    before = os.umask(0)
    yield
    os.umask(before)


def test_private_keys_are_their_owner_s_only(store: Keystore, open_umask: None) -> None:
    """A private key is readable by its owner only, whatever the umask."""
    store.add(Identity("leg", "reader"), days=1)
    made = [*store.path.rglob("key.pem")]
    assert len(made) == 3
    assert {stat.S_IMODE(key.stat().st_mode) for key in made} == {0o600}


def test_a_private_key_is_never_there_for_others(
    tmp_path: Path, open_umask: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is so from its first byte on: the file is made with these rights."""
    modes: list[int] = []
    opened = os.open

    def note(path: str, flags: int, mode: int = 0o777) -> int:
        descriptor = opened(path, flags, mode)
        modes.append(stat.S_IMODE(os.fstat(descriptor).st_mode))
        return descriptor

    monkeypatch.setattr(os, "open", note)
    write_private(tmp_path / "key.pem", b"secret")
    assert modes == [0o600]


@pytest.mark.real
def test_openssl_takes_the_certificates(store: Keystore) -> None:
    """The certificate of an identity is valid by the authority's, as others see it."""
    openssl = needs.program("openssl")
    folder = store.path / "arm"
    checked = subprocess.run(
        [openssl, "verify", "-CAfile", folder / "authority.pem", folder / "certificate.pem"],
        capture_output=True,
        text=True,
    )
    assert checked.stdout.endswith("certificate.pem: OK\n")


def test_an_exported_identity_can_be_used_by_itself(store: Keystore, tmp_path: Path) -> None:
    """The exported folder has all that a machine needs, and not the authority's key."""
    store.export("arm", tmp_path / "away")
    folder = open_folder(tmp_path / "away")
    assert folder.identity == Identity("arm", "publisher", hosts=("arm.local", "10.0.0.7"))
    assert folder.key.read_bytes() != (store.path / "authority" / "key.pem").read_bytes()
    with pytest.raises(SettingsError, match="not empty"):
        store.export("arm", tmp_path / "away")


def test_rights_that_were_edited_by_hand_are_those_of_every_use(
    store: Keystore, tmp_path: Path
) -> None:
    """There is one file: what is taken away there is neither exported nor used from the keystore.
    `check` names the machines that still have it, until they are exported to.
    """
    store.export("arm", tmp_path / "before")
    rights = store.path / "rights.yaml"
    # A copy of a former keystore.
    (store.path / "arm" / "rights.yaml").write_bytes(rights.read_bytes())
    rights.write_text("identities: {arm: {role: publisher, topics: [pose]}}  # by hand\n")
    for _ in range(2):
        assert "topics:  pose" in keys(store, "show", "arm")[1]
        assert open_folder(store.path / "arm").identity.topics == ("pose",)
        assert open_folder(tmp_path / "before").identity.topics is None
        code, said = keys(store, "check")
        assert code == 1 and said.startswith("arm: ") and "former rights of arm: tfbus" in said
        store.renew("arm", days=90)
    store.export("arm", tmp_path / "after")
    assert (tmp_path / "after" / "rights.yaml").read_bytes() == rights.read_bytes()
    assert open_folder(tmp_path / "after").identity.topics == ("pose",)
    assert keys(store, "check")[0] == 0


def test_machines_with_the_same_former_rights_are_one_sentence(
    store: Keystore, tmp_path: Path
) -> None:
    """After one of thirty robots was revoked, the others have no line each."""
    for name in ("leg", "laptop"):
        store.add(Identity(name, "reader"), days=90)
    for name in store.rights.identities:
        store.export(name, tmp_path / name)
    store.revoke("laptop")
    code, said = keys(store, "check")
    assert code == 1
    [line] = said.splitlines()
    assert line.startswith("arm, leg: their machines have the former rights of laptop: ")


def test_the_folder_of_a_keystore_is_not_for_another_machine(
    store: Keystore, tmp_path: Path
) -> None:
    """A copy by hand would have rights of some day: it has none, and says what makes it."""
    shutil.copytree(store.path / "arm", tmp_path / "away")
    with pytest.raises(SettingsError, match=r"no rights\.yaml: export"):
        open_folder(tmp_path / "away")


def test_all_is_well(store: Keystore) -> None:
    """`check` finds nothing in a new keystore."""
    assert keys(store, "check") == (0, "identities: 1, all is well\n")


def spoil_mode(store: Keystore) -> None:
    (store.path / "arm" / "key.pem").chmod(0o644)


def spoil_time(store: Keystore) -> None:
    store.renew("arm", days=-0.001)


def spoil_soon(store: Keystore) -> None:
    store.renew("arm", days=3)


def spoil_file(store: Keystore) -> None:
    (store.path / "arm" / "certificate.pem").unlink()


def spoil_key(store: Keystore) -> None:
    write_private(
        store.path / "arm" / "key.pem", (store.path / "authority" / "key.pem").read_bytes()
    )


def spoil_certificate(store: Keystore) -> None:
    (store.path / "arm" / "certificate.pem").write_text("spoilt")


def spoil_authority(store: Keystore) -> None:
    (store.path / "authority" / "certificate.pem").write_text("spoilt")


def spoil_authority_key(store: Keystore) -> None:
    path = store.path / "authority" / "key.pem"
    key = serialization.load_pem_private_key(path.read_bytes(), None)
    write_private(
        path,
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.BestAvailableEncryption(b"secret"),
        ),
    )


def exchange_authority_key(store: Keystore) -> None:
    shutil.copy(store.path / "arm" / "key.pem", store.path / "authority" / "key.pem")


def spoil_name(store: Keystore) -> None:
    (store.path / "arm" / "identity.yaml").write_text("name: arm")


def spoil_zone(store: Keystore) -> None:
    times = "begins: 2020-01-01\nends: 2120-01-01"
    (store.path / "arm" / "identity.yaml").write_text(f"name: arm\n{times}")


def spoil_rights(store: Keystore) -> None:
    store.export("arm", store.path.parent / "away")
    store.add(Identity("leg", "reader"), days=90)


def spoil_former(store: Keystore) -> None:
    # As former keystores had it.
    (store.path / "arm" / "rights.yaml").write_text("identities: {arm: {role: admin}}")


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (spoil_mode, "others may read the private key"),
        (spoil_time, "arm: expired on "),
        (spoil_soon, "arm: expires on "),
        (spoil_file, "arm: 1 file missing: certificate.pem"),
        (spoil_key, "arm: its private key is not that of its certificate"),
        (spoil_certificate, "arm: a file is not a certificate or key"),
        (spoil_rights, "arm: its machine has the former rights of leg: tfbus keys export arm"),
        (spoil_authority, "authority/certificate.pem is no certificate"),
        (spoil_authority_key, "the private key is encrypted"),
        (exchange_authority_key, "the private key is not that of the certificate"),
        (spoil_former, "arm: its machine has the former rights of arm: tfbus keys export arm"),
    ],
)
def test_check_finds_what_is_wrong(store: Keystore, spoil: object, problem: str) -> None:
    """What is missing, expired, readable by others or does not fit is named."""
    assert callable(spoil)
    spoil(store)
    code, output = keys(store, "check")
    assert (code, problem in output) == (1, True), output


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (spoil_mode, "chmod 600"),
        (spoil_file, "export the identity again"),
        (lambda store: store.revoke("arm"), "was revoked on"),
        (spoil_name, "identity.yaml:1: has no begins, ends: export the identity again"),
        (spoil_zone, "identity.yaml:2: begins: .* is not a time with its zone"),
    ],
)
def test_a_folder_that_cannot_be_used_says_why(store: Keystore, spoil: object, reason: str) -> None:
    """An identity that is not safe, whole or valid is refused before anything is sent."""
    assert callable(spoil)
    spoil(store)
    with pytest.raises(TfbusError, match=reason):
        open_folder(store.path / "arm")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("add", "arm", "--role", "reader"), 2, "there is an identity 'arm' already"),
        (("add", "authority", "--role", "reader"), 2, "'authority'"),
        (("add", "a b", "--role", "reader"), 2, "cannot be a node's name"),
        (("add", "arm_left", "--role", "reader"), 2, "identity 'arm' has arm_*"),
        (("add", "leg"), 2, "Missing option '--role'"),
        (("add", "leg", "--role", "boss"), 2, "'boss' is not one of"),
        (("add", "leg", "--role", "reader", "--frames", "a**"), 2, "whole parts"),
        (("add", "leg", "--role", "reader", "--hosts", "müller"), 2, "use ASCII letters"),
        (("add", "leg", "--role", "reader", "--hosts", ""), 2, "use ASCII letters"),
        (("renew", "leg"), 2, "there is no identity 'leg'"),
        (("revoke", "amr"), 2, "did you mean 'arm'"),
        (("export", "leg"), 2, "there is no identity 'leg'"),
    ],
)
def test_a_mistake_is_one_sentence(
    store: Keystore, arguments: tuple[str, ...], code: int, message: str
) -> None:
    """A mistake of the user's ends in a sentence, and changes nothing."""
    before = sorted(store.path.rglob("*"))
    result, output = keys(store, *arguments)
    assert (result, message in output) == (code, True), output
    assert sorted(store.path.rglob("*")) == before


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (spoil_authority, "are no authority"),
        (spoil_authority_key, "the private key is encrypted"),
        (exchange_authority_key, "the private key is not that of the certificate"),
    ],
)
def test_a_spoilt_authority_issues_nothing(store: Keystore, spoil: object, reason: str) -> None:
    """An identity that no bus would accept is not made, and a sentence says why."""
    assert callable(spoil)
    spoil(store)
    code, output = keys(store, "add", "leg", "--role", "reader")
    assert (code, reason in output) == (2, True), output
    assert not (store.path / "leg").exists()


def test_an_expired_authority_issues_nothing(tmp_path: Path) -> None:
    """Its identities would have ended with it."""
    store = Keystore.init(tmp_path / "keys", days=-0.001)
    code, output = keys(store, "add", "arm", "--role", "reader")
    assert (code, "expired on" in output, "keys init" in output) == (2, True, True), output


def test_an_authority_that_ends_soon_is_not_to_be_renewed_as_an_identity(tmp_path: Path) -> None:
    """The remedy is a new authority."""
    (problem,) = Keystore.init(tmp_path / "keys", days=3).problems()
    assert "keys init" in problem
    assert "renew" not in problem


@pytest.mark.parametrize("kept", ["certificate.pem", "key.pem", ""])
def test_an_authority_is_never_replaced(store: Keystore, kept: str) -> None:
    """`init` refuses a keystore of which parts are kept elsewhere, and its rights stay."""
    for name in {"certificate.pem", "key.pem"} - {kept}:
        (store.path / "authority" / name).unlink()
    before = {path: path.read_bytes() for path in store.path.rglob("*.*")}
    result = CliRunner().invoke(main, ["keys", "init", str(store.path)])
    assert (result.exit_code, "authority" in result.output) == (2, True), result.output
    assert {path: path.read_bytes() for path in store.path.rglob("*.*")} == before


@pytest.mark.real
def test_identities_that_are_added_at_once_are_all_there(store: Keystore) -> None:
    """Of several commands none takes back what another has written, such as a revocation."""
    commands = [
        *(["add", f"robot{number}", "--role", "reader"] for number in range(4)),
        ["revoke", "arm"],
    ]
    started = [
        subprocess.Popen([sys.executable, "-m", "tfbus", "keys", *each, "--keys", str(store.path)])
        for each in commands
    ]
    assert [each.wait() for each in started] == 5 * [0]
    identities = store.rights.identities
    assert identities.keys() == {"arm", *(f"robot{number}" for number in range(4))}
    assert identities["arm"].revoked


def test_a_keystore_s_folder_may_have_a_long_name(tmp_path: Path) -> None:
    """The authority's name, which X.509 limits, has its beginning."""
    assert Keystore.init(tmp_path / ("ä" * 100), days=1).listed() == []


def test_the_keystore_itself_is_no_identity(store: Keystore) -> None:
    """`--secure keys` is answered with the identities that are in it."""
    with pytest.raises(SettingsError, match=r"one of .*keys/arm"):
        open_folder(store.path)
