"""systemd: the unit that starts a launch file at boot, a running launch's messages to the service
manager, and its journal; and an image of the same.
"""

import json
import os
import re
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.wording import printable

# It is told three times as often as it waits.
_TOLD_AS_OFTEN = 3

_LEVEL = re.compile(rb"\[(DEBUG|INFO|WARN|WARNING|ERROR|FATAL)\]")
_LEVELS = {
    b"DEBUG": b"<7>",
    b"INFO": b"<6>",
    b"WARN": b"<4>",
    b"WARNING": b"<4>",
    b"ERROR": b"<3>",
    b"FATAL": b"<2>",
}


class ServiceManager:
    """Tells the manager how it goes, if there is one. Removes its variables from the environment,
    so that child processes do not inherit them.
    """

    def __init__(self) -> None:
        address = os.environ.pop("NOTIFY_SOCKET", "")
        # One of Linux's that is no file begins with a zero byte.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        wait_us = os.environ.pop("WATCHDOG_USEC", "")
        is_ours = os.environ.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        # How often it has to be told that this process lives; None for never.
        self.every_s: float | None = None
        if self._address and is_ours and wait_us.isdecimal() and int(wait_us):
            self.every_s = int(wait_us) / 1e6 / _TOLD_AS_OFTEN

    def notify(self, *facts: str) -> None:
        """Tell it facts, such as `READY=1`; nothing without a manager, or if it does not listen."""
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as told:
                told.setblocking(False)
                told.sendto("\n".join(facts).encode(), self._address)


def is_journal(descriptor: int) -> bool:
    """Whether a file descriptor leads to the journal: lines may say their level there."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    with suppress(OSError):
        found = os.fstat(descriptor)
        return (device, inode) == (str(found.st_dev), str(found.st_ino))
    return False


def journal_level(line: bytes) -> bytes:
    """The level of a line of a log, as the journal reads it in front; b"" if it says none."""
    found = _LEVEL.match(line)
    return _LEVELS[found[1]] if found else b""


MARK = "# Written by `tfbus service install`; `tfbus service uninstall` removes it."

# Longer than launch takes to end its processes.
_STOPS_WITHIN_S = 15
# Launch tells that it lives three times as often.
_WATCHDOG_S = 30
_AGAIN_AFTER_S = 2
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9:_.-]{0,99}")


@dataclass(frozen=True)
class Service:
    """A service: its name, the command that it runs and in which folder, its environment, and the
    user that it runs as, "" for the one whose service manager it is in, or root.
    """

    name: str
    command: Sequence[str]
    folder: Path
    environment: Mapping[str, str]
    user: str = ""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InvalidArgumentException(
                f"'{printable(self.name, 60)}' cannot be the name of a service: use letters, "
                "digits, ':', '_', '.' and '-', and give another one with --name"
            )
        for text in (*self.command, str(self.folder), self.user, *self.environment.values()):
            _check_printable(text)


def _check_printable(text: str) -> None:
    if not text.isprintable():
        raise InvalidArgumentException(
            f"'{printable(text, 60)}' has a character that such a file cannot hold"
        )


def unit_text(service: Service, *, is_system: bool) -> str:
    """The unit of a service of the whole system, or of a user."""
    # A dollar begins a variable there.
    command = " ".join(_quoted(word).replace("$", "$$") for word in service.command)
    environment = [
        f"Environment={_quoted(f'{name}={value}')}"
        for name, value in sorted(service.environment.items())
    ]
    lines = [
        MARK,
        "[Unit]",
        f"Description={_escaped(f'tfbus: {service.name}')}",
        # A network may come later, and processes of tfbus join it then.
        "After=network.target",
        "StartLimitIntervalSec=0",
        "",
        "[Service]",
        "Type=notify",
        "NotifyAccess=main",
        f"ExecStart={command}",
        f"WorkingDirectory={_escaped(str(service.folder))}",
        *environment,
        *([f"User={service.user}"] if service.user else []),
        "Restart=always",
        f"RestartSec={_AGAIN_AFTER_S}",
        # Nodes may wait for others that come later.
        "TimeoutStartSec=infinity",
        f"TimeoutStopSec={_STOPS_WITHIN_S}",
        f"WatchdogSec={_WATCHDOG_S}",
        # Launch ends its processes itself.
        "KillMode=mixed",
        "LimitNOFILE=65536",
        f"SyslogIdentifier={service.name}",
        "",
        "[Install]",
        f"WantedBy={'multi-user' if is_system else 'default'}.target",
        "",
    ]
    return "\n".join(lines)


def container_text(file: str, arguments: Sequence[str], extras: str) -> str:
    """A container file for a launch file and all in its folder; the image's entry point is
    `tfbus launch` with these arguments. Raises InvalidArgumentException for a text that cannot
    stand there.
    """
    entry = ["tfbus", "launch", file, *arguments]
    for text in entry:
        _check_printable(text)
    path = PurePosixPath(file)
    name = re.sub(r"[^a-z0-9]+", "-", path.stem.lower()).strip("-") or "robot"
    return f"""\
# The folder of {path.name} with tfbus, of a clone of it:
#   docker build -t {name} -f Containerfile --build-context tfbus=CLONE .
#   docker run -d --restart unless-stopped --network host --init {name}
# The host's network carries multicast; -e TFBUS_NAMESPACE=robot7 gives settings. Keys of a closed
# bus belong in no image: -v /etc/tfbus/robot7:/keys:ro -e TFBUS_SECURE=/keys
FROM python:3.12 AS build
COPY --from=tfbus . /tfbus
RUN pip wheel --wheel-dir /wheels "/tfbus[{extras}]"

FROM python:3.12-slim
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \\
    pip install --no-cache-dir --no-index --find-links /wheels "tfbus[{extras}]"
RUN useradd --create-home robot
COPY --chown=robot . /robot
USER robot
WORKDIR /robot
STOPSIGNAL SIGTERM
ENTRYPOINT {json.dumps(entry, ensure_ascii=False)}
"""


def _escaped(text: str) -> str:
    """A text of a unit: `%` begins a specifier there."""
    return text.replace("%", "%%")


def _quoted(text: str) -> str:
    """A word of a command line, or of an environment, of a unit."""
    text = _escaped(text).replace("\\", "\\\\").replace('"', '\\"')
    return text if re.fullmatch(r"[\w@%+=:,./-]+", text, re.ASCII) else f'"{text}"'
