"""What a closed bus costs beside an open one: latency and CPU of a message, and the start of a
process, with the rules of 1 identity or of 200.

    python -m benchmarks.bus.secure
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.bus import latency, paced, startup
from benchmarks.bus.place import Place, place

MESSAGES = 2_000
RUNS = 3
MANY = 200


class ClosedPlace(Place):
    """A place on a closed bus, whose processes have one of this number of identities."""

    def __init__(self, folder: Path, identities: int) -> None:
        from tfbus.bus.keystore import Keystore
        from tfbus.bus.rights import Identity, Rights

        super().__init__(folder)
        self.endpoint = self.endpoint.replace("tcp/", "tls/")
        store = Keystore.init(folder / "keys", days=1)
        store.add(Identity("bench", "publisher", nodes=("**",)), days=1)
        others = {
            f"robot{number}": Identity(f"robot{number}", "publisher", f"fleet/robot{number}")
            for number in range(1, identities)
        }
        store.set_rights(Rights({**store.rights.identities, **others}))
        self.env["TFBUS_SECURE"] = str(folder / "keys" / "bench")


@contextmanager
def closed_place(identities: int = 1) -> Iterator[Place]:
    """A closed place in a folder that goes away."""
    with TemporaryDirectory(prefix="tfbus-bench-") as folder:
        yield ClosedPlace(Path(folder), identities)


_PLACES = {
    "open": place,
    "closed": closed_place,
    f"closed, {MANY} identities": lambda: closed_place(MANY),
}


def measure(runs: int) -> dict[str, dict[str, float]]:
    """Of each place p50 and p99 in us, CPU of a message in us, and the start in ms: medians of runs
    that take turns.
    """
    taken: dict[str, list[dict[str, float]]] = {kind: [] for kind in _PLACES}
    for _ in range(runs):
        for kind, make in _PLACES.items():
            with make() as at:
                took = latency.latency_at(at, MESSAGES)
            with make() as at:
                cpu_s = paced.cpu_of_a_message(at)
            with make() as at:
                phases = startup.measure_at(
                    at, 3, "startup:look_up", at.connecting(), at.listening()
                )
            taken[kind].append(
                {
                    "p50": took.p50_us,
                    "p99": took.p99_us,
                    "cpu": 1e6 * cpu_s,
                    "start": 1e3 * phases["all"],
                }
            )
    return {
        kind: {what: median(each[what] for each in some) for what in some[0]}
        for kind, some in taken.items()
    }


def main() -> None:
    """Measure, and print a table with ratios to the open bus."""
    found = measure(RUNS)
    units = {"p50": "us", "p99": "us", "cpu": "us a message", "start": "ms"}
    for kind, values in found.items():
        cells = [
            f"{what} {value:.0f} {units[what]} ({value / found['open'][what]:.2f} x)"
            for what, value in values.items()
        ]
        print(f"{kind}: {', '.join(cells)}")


if __name__ == "__main__":
    main()
