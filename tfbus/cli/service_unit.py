"""`tfbus service install`, `uninstall` and `container`: a launch file that is started at boot."""

import io
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import click

from tfbus.cli import Answering
from tfbus.cli.output import print_lines, print_text, warn
from tfbus.errors import InvalidArgumentException
from tfbus.launch.find import installed_launch_files
from tfbus.launch.service_manager import MARK, Service, container_text, unit_text

# There while systemd runs this machine.
_SYSTEMD = Path("/run/systemd/system")
_SYSTEM_UNITS = Path("/etc/systemd/system")

_PASSED_ON = {"ignore_unknown_options": True}
_AS_IN_LAUNCH = "[NAME:=VALUE|OPTION]..."
_SETTINGS = "TFBUS_"


def _unit_path(name: str, *, is_system: bool) -> Path:
    if is_system:
        return _SYSTEM_UNITS / f"{name}.service"
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "systemd" / "user" / f"{name}.service"


def _checked(file: str, arguments: Sequence[str]) -> tuple[Path, list[str]]:
    """The launch file and the arguments of `tfbus launch` for it, which takes them.

    Raises click's errors if it does not.
    """
    from tfbus.cli import launch  # asyncio and YAML, which `tfbus service list` does not need

    given = [file, *arguments]
    try:
        with redirect_stdout(io.StringIO()):
            launch.command.main(
                [*given, "--dry-run"], prog_name="tfbus launch", standalone_mode=False
            )
    except click.UsageError as error:
        # With the usage of this command, not of that one.
        raise click.UsageError(error.format_message(), click.get_current_context()) from error
    context = launch.command.make_context("tfbus launch", list(given), resilient_parsing=True)
    path, rest = launch.chosen_file(file, context.params.get("arguments") or ())
    left = list(arguments)
    if len(rest) < len(context.params.get("arguments") or ()):
        left.remove(context.params["arguments"][0])  # of PACKAGE FILE
    return path.absolute(), left


@click.command(
    "install",
    cls=Answering,
    context_settings=_PASSED_ON,
    epilog="Examples: tfbus service install robot.yaml --network mobile; "
    "sudo tfbus service install robot.yaml --run-as robot; tfbus service install turtle --print",
)
@click.argument("file", metavar="FILE")
@click.argument("arguments", nargs=-1, metavar=_AS_IN_LAUNCH, type=click.UNPROCESSED)
@click.option("--name", metavar="NAME", help="The name of the service (default that of FILE).")
@click.option("--system", is_flag=True, help="For the machine, at boot; the default of root.")
@click.option("--user", "is_user", is_flag=True, help="For you alone; the default of others.")
@click.option("--run-as", metavar="USER", default="", help="The user of a service of the machine.")
@click.option("--print", "only_print", is_flag=True, help="Print the unit, and install nothing.")
def install_command(
    file: str,
    arguments: tuple[str, ...],
    name: str | None,
    system: bool,
    is_user: bool,
    run_as: str,
    only_print: bool,
) -> None:
    """Write a unit of systemd that runs a launch file from boot on.

    FILE and what follows are as in `tfbus launch`, and settings in the environment (TFBUS_...) are
    kept. The service is started again when it ends or hangs, and writes to the journal with levels.
    """
    path, rest = _checked(file, arguments)
    is_system = _is_system(system, is_user)
    if run_as and not is_system:
        raise click.UsageError("--run-as is for services of the machine: give --system")
    if run_as:
        _check_user(run_as, is_for_here=_has_systemd() and not only_print)
    try:
        service = Service(
            name or path.stem,
            [sys.executable, "-m", "tfbus", "launch", str(path), *rest],
            Path.cwd(),
            {"PATH": _path()}
            | {key: value for key, value in os.environ.items() if key.startswith(_SETTINGS)},
            run_as or (os.environ.get("SUDO_USER", "") if is_system else ""),
        )
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error
    text = unit_text(service, is_system=is_system)
    if only_print:
        print_text(text.rstrip())
        return
    unit = _unit_path(service.name, is_system=is_system)
    _write(unit, text)
    print_text(f"Wrote {unit}")
    _systemctl(is_system, [["daemon-reload"], ["enable", "--now", service.name]])
    if not is_system:
        print_text(f"So that it runs from boot on: sudo loginctl enable-linger {_login()}")
    of = f"-u {service.name}" if is_system else f"--user -u {service.name}"
    print_text(f"Look at it: journalctl {of} -f")


@click.command("uninstall", epilog="Example: tfbus service uninstall robot")
@click.argument("name")
@click.option("--system", is_flag=True, help="One of the machine; the default of root.")
@click.option("--user", "is_user", is_flag=True, help="One of yours; the default of others.")
def uninstall_command(name: str, system: bool, is_user: bool) -> None:
    """Stop a service that `install` has written, and remove its unit."""
    is_system = _is_system(system, is_user)
    name = name.removesuffix(".service")
    unit = _unit_path(name, is_system=is_system)
    if not _is_ours(unit):
        raise click.ClickException(f"{unit} is not there, or not of tfbus service install")
    _systemctl(is_system, [["disable", "--now", name]])
    unit.unlink()
    print_text(f"Removed {unit}")
    _systemctl(is_system, [["daemon-reload"]])


@click.command(
    "container",
    cls=Answering,
    context_settings=_PASSED_ON,
    epilog="Example: tfbus service container robot.yaml > Containerfile",
)
@click.argument("file", metavar="FILE")
@click.argument("arguments", nargs=-1, metavar=_AS_IN_LAUNCH, type=click.UNPROCESSED)
@click.option(
    "--extras", default="bag", show_default=True, help="The extras of tfbus in the image."
)
def container_command(file: str, arguments: tuple[str, ...], extras: str) -> None:
    """Print a container file for an image that runs a launch file, with all in its folder.

    FILE and what follows are as in `tfbus launch`. The first lines say how to build and run it.
    """
    path, rest = _checked(file, arguments)
    # One of tfbus's own is in the image by its name.
    supplied = {each.absolute(): name for name, each in installed_launch_files().items()}
    try:
        text = container_text(supplied.get(path, f"/robot/{path.name}"), rest, extras)
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error
    print_lines(text.splitlines())


def _path() -> str:
    """The PATH of a service: first the programs beside this Python, such as `tfbus`, which those of
    systemd's own are not.
    """
    return f"{Path(sys.executable).parent}:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"


def _is_system(system: bool, is_user: bool) -> bool:
    if system and is_user:
        raise click.UsageError("--system and --user exclude each other")
    return system or (os.geteuid() == 0 and not is_user)


def _check_user(user: str, *, is_for_here: bool) -> None:
    """Refuse a user that this machine has not got, with whom systemd would start nothing; only warn
    of it if the unit may be for another machine, or an image.
    """
    import pwd  # Windows has none

    try:
        # systemd takes a number, too, and of that no name is needed.
        if not user.isdecimal():
            pwd.getpwnam(user)
    except (KeyError, ValueError):
        missing = f"--run-as: this machine has no user {user!r}"
        if is_for_here:
            raise click.UsageError(
                f"{missing}: make it (sudo useradd --create-home NAME), or name another"
            ) from None
        warn(f"{missing}; where the unit runs there must be one, or systemd starts nothing")


def _has_systemd() -> bool:
    """Whether systemd runs on this machine."""
    return _SYSTEMD.is_dir() and shutil.which("systemctl") is not None


def _login() -> str:
    return os.environ.get("USER") or "$USER"


def _is_ours(unit: Path) -> bool:
    try:
        return unit.read_text(encoding="utf-8").startswith(MARK)
    except (OSError, UnicodeDecodeError):
        return False


def _write(unit: Path, text: str) -> None:
    if unit.exists() and not _is_ours(unit):
        raise click.ClickException(
            f"{unit} is there and was not written by tfbus: give another name with --name"
        )
    try:
        unit.parent.mkdir(parents=True, exist_ok=True)
        unit.write_text(text, encoding="utf-8")
    except OSError as error:
        raise click.ClickException(
            f"could not write {unit}: {error.strerror or error}; a service of the machine needs "
            "root, one of yours --user"
        ) from error


def _systemctl(is_system: bool, commands: Sequence[Sequence[str]]) -> None:
    """Run commands of systemctl, or print them where systemd does not run."""
    called = ["systemctl", *([] if is_system else ["--user"])]
    runs = _has_systemd()
    for words in commands:
        line = " ".join([*called, *words])
        if not runs:
            print_text(f"systemd does not run here; where it does: {line}")
            continue
        done = subprocess.run([*called, *words], check=False)
        if done.returncode:
            warn(f"'{line}' failed with exit code {done.returncode}")
