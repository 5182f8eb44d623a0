"""The order in which the workers of pytest-xdist collect and run the tests.

Each begins with real ones. These take seconds, most of them waiting, and others milliseconds of a
processor. A worker that is done takes over the end of another one's list: with short tests there,
all end together.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TypeVar

import pytest

from tests.real_tests import MARKER

T = TypeVar("T")


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Iterator[None]:
    """Let every other worker collect from the other end: in a fresh clone pytest rewrites the
    asserts of each file, which takes longer than all imports, and the workers do so half each.
    """
    report = yield
    if isinstance(collector, pytest.Directory) and _worker(collector.config) % 2:
        report.result.reverse()
    return report


def _worker(config: pytest.Config) -> int:
    """The number of this worker; 0 where there are none."""
    return int(getattr(config, "workerinput", {}).get("workerid", "gw0").removeprefix("gw"))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort the files, for one order in all workers, and deal the real ones to them.

    Tests of the whole project come first, so that one worker has them and parses it once.
    """
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    if workers > 1:
        items.sort(key=lambda item: (len(item.path.parts), item.path))
    real = [item for item in items if item.get_closest_marker(MARKER)]
    if workers > 1 and real:
        files = [list(tests) for _, tests in groupby(real, key=lambda item: item.path)]
        others = [item for item in items if not item.get_closest_marker(MARKER)]
        items[:] = dealt(files, others, workers)


def dealt(files: Sequence[Sequence[T]], others: Sequence[T], workers: int) -> list[T]:
    """The tests in the order in which xdist cuts them into lists of one length, one for each of the
    workers: each list begins with whole files, all with about as many of their tests.
    """
    lists: list[list[T]] = [[] for _ in range(workers)]
    for tests in sorted(files, key=len, reverse=True):
        min(lists, key=len).extend(tests)
    rest = list(others)
    total = sum(map(len, files)) + len(rest)
    for at, tests_of_worker in enumerate(lists):
        size = total // (workers - at)
        total -= size
        short = max(0, size - len(tests_of_worker))
        tests_of_worker += rest[:short]
        del rest[:short]
    return [test for tests_of_worker in lists for test in tests_of_worker] + rest
