"""The order in which the workers of pytest-xdist run the tests: each begins with real ones.

Real tests take seconds, most of them waiting, and others milliseconds of a processor. A worker that
is done takes over the end of another one's list: with short tests there, all end together.
"""

from collections.abc import Sequence
from itertools import groupby
from typing import TypeVar

import pytest

from tests.real_tests import MARKER

T = TypeVar("T")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deal the real tests to the workers, file by file."""
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
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
