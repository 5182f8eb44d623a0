"""The file of rights, rights.yaml: read with its lines, written for people to edit."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tfbus.errors import TfbusError
from tfbus.runtime.whole_file import replacing
from tfbus.runtime.yaml_file import Value, read_yaml_file
from tfbus.secure.rights import RIGHTS, Identity, Rights

RIGHTS_FILE = "rights.yaml"

_FIELDS = ("role", "namespace", *RIGHTS, "hosts", "revoked")
_LISTS = (*RIGHTS, "hosts")

_HEAD = """\
# Who may do what on this bus. `tfbus keys` writes this file; edit it as you like, then copy it to
# every machine (tfbus keys export), and restart what runs there.
#
# Each identity has a role: reader, publisher, operator, router or admin. All names are within its
# namespace. A right that is not here is that of the role; patterns have * for letters and ** for
# any parts: arm/*.
#   nodes   names of its nodes and of their streams     topics  topics that it may publish
#   frames  child frames that it may publish            serves  services that it may serve
#   calls   services that it may call                   sets    node/parameter that it may set
"""


def read_rights(path: Path) -> Rights:
    """The rights in a file. Raises YamlFileError, with the line of a mistake."""
    document = read_yaml_file(path, "identities, with a role each").fields(("identities",))
    if "identities" not in document:
        return Rights()
    entries = document["identities"]
    named = {} if entries.is_empty else entries.entries()
    identities = {name: _identity(name, value) for name, value in named.items()}
    try:
        return Rights(identities)
    except TfbusError as error:
        raise entries.place.mistake(str(error)) from error


def _identity(name: str, value: Value) -> Identity:
    fields = value.fields(_FIELDS)
    if "role" not in fields:
        raise value.place.mistake("has no role: write role: reader")
    given: dict[str, Any] = {}
    for key, each in fields.items():
        given[key] = tuple(part.text() for part in each.items()) if key in _LISTS else each.text()
    try:
        return Identity(name, **given)
    except TfbusError as error:
        raise value.place.mistake(str(error)) from error


def write_rights(path: Path, rights: Rights) -> None:
    """Write the rights, whole or not at all."""
    import yaml  # slow to import

    identities = {name: _as_map(each) for name, each in rights.identities.items()}
    text = yaml.safe_dump(
        {"identities": identities}, sort_keys=False, allow_unicode=True, default_flow_style=None
    )
    with replacing(path) as file:
        file.write((_HEAD + text).encode())


def _as_map(identity: Identity) -> Mapping[str, object]:
    values = {key: getattr(identity, key) for key in _FIELDS}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in values.items()
        if value not in (None, "", ()) or (key in RIGHTS and value == ())
    }
