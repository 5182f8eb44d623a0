"""Spoilt payloads harm nothing: a short run of the fuzzer, the same each time."""

from tests.processes.fuzz_transforms import fuzz


def test_spoilt_payloads_are_counted_and_harm_nothing() -> None:
    """Of 3,000 spoilt payloads each is read or refused for a reason, and no edge is harmed."""
    told = fuzz(seed=1, payloads=3_000)
    assert told["payloads"] == 3_000
    assert told["read"] + told["outdated"] + told["refused"] == 3_000
    assert told["read"] > 300
    assert told["refused"] > 300
    assert told["rows refused"] > 30
