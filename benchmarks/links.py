"""What a listener knows of a robot behind a bad link: python -m benchmarks.links [NAME ...]

A robot of 50 dynamic frames and 20 static ones, its router, a link of the tests' own, and on the
other host a router and a listener. Each row is a link with one of the networks that `--network`
names. It needs root, and writes the table of docs/guide/scaling.md; `--print` does not.
"""

import argparse
import json
import os
import sys
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks import machine
from benchmarks.bus.links import SETTLE_S, Heard
from benchmarks.bus.place import Process, place
from benchmarks.parts import Table
from tests.hosts.lossy_link import Conditions
from tests.hosts.network import Hosts

SECONDS = 15.0


@dataclass(frozen=True)
class Film:
    """The images of a camera: bytes of each, and how many a second."""

    size: int
    hz: float


# 640 by 480 pixels in colour, and such an image as JPEG or smaller.
RAW, COMPRESSED = Film(921_600, 15.0), Film(100_000, 5.0)
# More than this host carries.
FULL = Film(921_600, 2_000.0)
_MOST_HZ = 50.0
_KEPT = Path(__file__).parent / "measured" / "links.json"
_PAGE = Path(__file__).parent.parent / "docs" / "guide" / "scaling.md"
_BEGIN, _END = "<!-- made by benchmarks.links -->\n", "<!-- end of it -->\n"


@dataclass(frozen=True)
class Link:
    """A link as the table calls it, and how often a second the robot sends over it."""

    text: str
    conditions: Conditions
    hz: float = 10.0


_MBIT = 125_000.0
LINKS = {
    "wifi": Link("Wi-Fi: 5 ± 3 ms, 1 % lost in bursts", Conditions(0.005, 0.003, 0.01, burst=3.0)),
    "lte": Link("LTE: 60 ± 30 ms, 1 %", Conditions(0.06, 0.03, 0.01)),
    "satellite": Link("satellite: 300 ms, 2 %", Conditions(0.3, 0.0, 0.02)),
    "loss": Link("20 ± 5 ms, 20 %", Conditions(0.02, 0.005, 0.2)),
    "far-loss": Link("250 ± 50 ms, 20 %", Conditions(0.25, 0.05, 0.2)),
    "narrow": Link(
        "1 Mbit/s, 30 ms, at 50 Hz: 1.6 Mbit/s are sent",
        Conditions(0.03, bytes_a_second=_MBIT, queue_s=1.0),
        50.0,
    ),
}
ROWS = (
    *(("wifi", "lan"), ("wifi", "wifi"), ("lte", "lan"), ("lte", "mobile"), ("satellite", "lan")),
    *(("satellite", "satellite"), ("loss", "lan"), ("loss", "wifi"), ("far-loss", "lan")),
    *(("far-loss", "satellite"), ("narrow", "lan"), ("narrow", "mobile")),
)


@dataclass(frozen=True)
class Row:
    """What was measured: the listener's, the robot's longest send, and bytes a second on the link
    from the robot.
    """

    heard: Heard
    longest_send_s: float
    bytes_a_second: float


def measure(link: Link, network: str, *, film: Film | None = None) -> Row:
    """One row; with `film` the robot has a camera, and the listener its images."""
    hosts = Hosts("robot", "desk", offline=("robot", "desk"))
    with place() as at, ExitStack() as stack:
        stack.callback(hosts.close)
        bad = hosts.join_by_link("robot", "desk", link.conditions)

        def start(host: str, function: str, env: dict[str, str], **arguments: Any) -> Process:
            def on(*command: str) -> list[str]:
                return [*hosts.command(host, *command)]

            return stack.enter_context(Process(at, function, env, on=on, **arguments))

        env = {**at.env, "TFBUS_NETWORK": network}
        here, there = f"tcp/{hosts.link_address['desk']}:7447", "tcp/127.0.0.1:7447"
        routing = {**env, "TFBUS_MODE": "router"}
        listening = {**routing, "TFBUS_LISTEN": f"{here} {there}"}
        start("desk", "interest:route", listening).hear()
        connecting = {**routing, "TFBUS_LISTEN": there, "TFBUS_CONNECT": here}
        start("robot", "interest:route", connecting).hear()
        client = {**env, "TFBUS_MODE": "client", "TFBUS_CONNECT": there}
        robot = start("robot", "links:publish", client, hz=link.hz)
        robot.hear()
        camera = None
        if film is not None:
            camera = start("robot", "links:film", client, **asdict(film))
            camera.hear()
        listener = start("desk", "links:listen", client, seconds=SECONDS, camera=bool(film))
        before = bad.counts()[0].bytes
        heard = Heard(**listener.hear())
        carried = bad.counts()[0].bytes - before
        if camera is not None:
            camera.tell()
            camera.hear()
        robot.tell()
        longest_s = robot.hear()
        listener.tell()
        took_s = SECONDS + SETTLE_S + (heard.joined_s or 0.0)
        return Row(heard, longest_s, carried / took_s)


def measure_here(*, film: Film | None) -> Heard:
    """A robot and a listener that are peers on this host; with `film` a camera fills its own link
    to the listener.
    """
    with place() as at, ExitStack() as stack:

        def start(function: str, env: dict[str, str], **arguments: Any) -> Process:
            return stack.enter_context(Process(at, function, env, **arguments))

        listener = start("links:listen", at.listening(), seconds=SECONDS, camera=bool(film))
        robot = start("links:publish", at.connecting(), hz=_MOST_HZ)
        robot.hear()
        if film is not None:
            start("links:film", at.connecting(), **asdict(film)).hear()
        heard = Heard(**listener.hear())
        listener.tell()
        return heard


# Beside a camera: a link as the table calls it, and its network. None is this host alone.
BESIDE: tuple[tuple[str, Conditions | None, str], ...] = (
    ("one host", None, "lan"),
    ("100 Mbit/s, 10 ms", Conditions(0.005, bytes_a_second=100 * _MBIT, queue_s=0.02), "lan"),
    ("100 Mbit/s, 10 ms", Conditions(0.005, bytes_a_second=100 * _MBIT, queue_s=0.02), "wifi"),
    ("10 Mbit/s, 10 ms", Conditions(0.005, bytes_a_second=10 * _MBIT), "lan"),
    ("10 Mbit/s, 10 ms", Conditions(0.005, bytes_a_second=10 * _MBIT), "wifi"),
)


def beside_camera() -> Table:
    """The age of a robot's frames at 50 Hz, alone and beside a camera that fills the link."""
    rows = []
    for text, conditions, network in BESIDE:
        alone, beside = (
            measure_here(film=FULL if film else None)
            if conditions is None
            else measure(Link(text, conditions, _MOST_HZ), network, film=film).heard
            for film in (None, RAW)
        )
        ages = [f"{1e3 * each:.0f} ms" for each in (alone.age_p99_s, beside.age_p99_s)]
        ratio = f"{beside.age_p99_s / alone.age_p99_s:.2f} x"
        rows.append([text, f"`{network}`", *ages, ratio, f"{beside.images_hz:.1f}"])
        print(rows[-1], alone, beside, f"load {os.getloadavg()[0]:.0f}", file=sys.stderr)
    headings = ["link, there and back", "network", "age p99 alone", "beside", "ratio", "images/s"]
    return Table(headings, rows, words=2)


def table(kept: dict[str, dict[str, Any]]) -> Table:
    """The table of the rows that are kept: a link a row, with its network beside `lan`."""
    headings = ["link, each way", "`lan`", "with", "age p50 / p99", "known 0.5 s ago"]
    headings += ["statics after", "false *gone*", "longest send"]
    rows = []
    for link, network in ROWS:
        if network == "lan" or f"{link}/{network}" not in kept:
            continue
        row, lan = kept[f"{link}/{network}"], kept.get(f"{link}/lan")
        heard = row["heard"]
        statics_s = heard["statics_s"]
        rows.append(
            [
                LINKS[link].text,
                "" if lan is None else _age(lan),
                f"`{network}`",
                _age(row),
                f"{100 * heard['answered']:.0f} %",
                "never" if statics_s is None else f"{statics_s:.1f} s",
                f"{heard['gone']}",
                f"{1e3 * row['longest_send_s']:.0f} ms",
            ]
        )
    return Table(headings, rows)


def _age(row: dict[str, Any]) -> str:
    return f"{row['heard']['age_p50_s']:.2f} / {row['heard']['age_p99_s']:.2f} s"


def _write(kept: dict[str, dict[str, Any]]) -> None:
    _KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    before, _, rest = _PAGE.read_text().partition(_BEGIN)
    after = rest.partition(_END)[2]
    _PAGE.write_text(f"{before}{_BEGIN}\n{table(kept).as_markdown()}\n\n{_END}{after}")


def main() -> None:
    """Measure the rows, and write the table."""
    parser = argparse.ArgumentParser(prog="benchmarks.links", description=__doc__)
    parser.add_argument("names", nargs="*", help="links, such as lte or lte/mobile; all")
    parser.add_argument("--print", action="store_true", help="write nothing")
    parser.add_argument(
        "--camera",
        action="store_true",
        help="beside a camera that sends 100 kB five times a second; write nothing",
    )
    given = parser.parse_args()
    film = COMPRESSED if given.camera else None
    kept = json.loads(_KEPT.read_text()) if _KEPT.exists() else {}
    print(machine.describe())
    for link, network in _chosen(given.names):
        row = asdict(measure(LINKS[link], network, film=film))
        print(link, network, row, f"load {os.getloadavg()[0]:.0f}", flush=True)
        kept[f"{link}/{network}"] = row
        if not given.print and film is None:
            _write(kept)


def _chosen(names: list[str]) -> list[tuple[str, str]]:
    """The rows that names choose: a link, or a link with a network."""
    chosen = []
    for name in names:
        link, _, network = name.partition("/")
        chosen += [(link, network)] if network else [row for row in ROWS if row[0] == link]
    return chosen if names else list(ROWS)


if __name__ == "__main__":
    main()
