"""Spoilt payloads harm nothing: a short run of the fuzzer, the same each time."""

from tests.processes.fuzz_transforms import fuzz


def test_spoilt_payloads_are_counted_and_harm_nothing() -> None:
    """Of 3,000 spoilt payloads each is read or refused for a reason, and no edge is harmed."""
    report = fuzz(seed=1, payloads=3_000)
    assert report["payloads"] == 3_000
    assert report["read"] + report["outdated"] + report["refused"] == 3_000
    assert report["read"] > 300
    assert report["refused"] > 300
    assert report["rows refused"] > 30
