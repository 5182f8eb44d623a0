"""The order of the tests for several workers."""

from hypothesis import given
from hypothesis import strategies as st

from tests.order import dealt


@given(st.lists(st.integers(1, 5), max_size=12), st.integers(0, 60), st.integers(2, 5))
def test_each_worker_begins_with_its_share_of_whole_files(
    counts: list[int], others: int, workers: int
) -> None:
    """No test is lost; where there are enough others, no file is cut and shares are alike."""
    files = [[f"{name}.{test}" for test in range(count)] for name, count in enumerate(counts)]
    rest = [f"other.{test}" for test in range(others)]
    order = dealt(files, rest, workers)
    assert sorted(order) == sorted([*rest, *(test for file in files for test in file)])
    size = len(order) // workers
    if size < sum(counts) / workers + max(counts, default=0):
        return
    shares = []
    left = list(order)
    for at in range(workers):
        mine, left = left[: len(left) // (workers - at)], left[len(left) // (workers - at) :]
        real = [test for test in mine if not test.startswith("other")]
        assert mine[: len(real)] == real
        shares.append(len(real))
        for file in files:
            assert {*file} <= {*real} or not {*file} & {*real}
    assert max(shares) - min(shares) <= max(counts, default=0)
