"""The messages of a stream that count, by their epochs."""

import pytest

from tfbus.base import scheduler
from tfbus.streams.stream_facts import Epochs, Verdict, is_from_future

PRESENT, OUTDATED = Verdict.PRESENT, Verdict.OUTDATED


@pytest.fixture
def epochs() -> Epochs:
    """The epochs of a stream whose present one is 2."""
    epochs = Epochs()
    epochs.judge(2)
    return epochs


def test_the_newest_epoch_counts() -> None:
    """Each later epoch restarts the stream; earlier ones are outdated."""
    epochs = Epochs()
    verdicts = [epochs.judge(epoch_ns) for epoch_ns in (1, 1, 3, 2, 3, 4)]
    assert verdicts == [
        Verdict.FIRST,
        PRESENT,
        Verdict.RESTART,
        OUTDATED,
        PRESENT,
        Verdict.RESTART,
    ]
    assert epochs.present_ns == 4


def test_after_the_publisher_was_gone_an_earlier_epoch_is_new(epochs: Epochs) -> None:
    """A restarted publisher may have an earlier epoch; the present one ends that exception."""
    epochs.vanish()
    epochs.appear()
    assert epochs.judge(1) is Verdict.RESTART
    epochs.vanish()
    epochs.appear()
    assert [epochs.judge(1), epochs.judge(0)] == [PRESENT, OUTDATED]


def test_late_messages_of_the_present_epoch_leave_the_publisher_gone(epochs: Epochs) -> None:
    """Only a token, or a new epoch, brings a publisher back."""
    epochs.vanish()
    assert (epochs.judge(2), epochs.gone, epochs.was_gone) == (PRESENT, True, True)
    assert (epochs.judge(3), epochs.gone, epochs.was_gone) == (Verdict.RESTART, False, False)


def test_a_second_live_publisher_takes_over_once_the_first_is_silent(epochs: Epochs) -> None:
    """Four outdated messages in a row, at least 0.35 s apart, count again; a later epoch too."""
    verdicts = [epochs.judge_live(1, 7, now_s) for now_s in (0.0, 0.4, 0.5, 0.8, 1.1, 1.2)]
    assert verdicts == [OUTDATED] * 5 + [Verdict.TAKEOVER]
    assert (epochs.present_ns, epochs.is_outdated(2)) == (1, True)
    assert epochs.judge(3) is Verdict.RESTART


def test_a_second_live_publisher_is_known_while_the_first_counts(epochs: Epochs) -> None:
    """Messages that count keep the present epoch; after seven outdated ones there are two."""
    for second in range(7):
        assert not epochs.second_publisher_is_alive
        assert epochs.judge_live(1, second, float(second)) is OUTDATED
    assert epochs.second_publisher_is_alive


def test_late_messages_of_a_dead_process_show_no_second_publisher(epochs: Epochs) -> None:
    """However many come at once, and however often processes of other epochs die."""
    for epoch_ns in range(-10, 2):
        for _ in range(100):
            assert epochs.judge_live(epoch_ns, epoch_ns, 10.0 * epoch_ns) is OUTDATED
    assert not epochs.second_publisher_is_alive


def test_kept_messages_show_no_second_publisher(epochs: Epochs) -> None:
    """Messages that were not sent just now may be of a dead process."""
    assert {epochs.judge(1) for _ in range(100)} == {OUTDATED}
    assert not epochs.second_publisher_is_alive


def test_an_epoch_a_minute_ahead_is_of_a_clock_that_differs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One further ahead is from the future."""
    monkeypatch.setattr(scheduler, "time_ns", lambda: 0)
    assert not is_from_future(60_000_000_000) and is_from_future(60_000_000_001)


def test_an_epoch_in_the_future_is_none_unless_its_publishers_clock_was_there_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By as much as when the present one began."""
    monkeypatch.setattr(scheduler, "time_ns", lambda: 10)
    minute = 60_000_000_000
    for ahead in (0, 3 * minute):
        epochs = Epochs()
        assert epochs.judge(10 + ahead) is Verdict.FIRST
        assert epochs.judge(11 + ahead + minute) is Verdict.FUTURE
        assert epochs.judge(10 + ahead + minute) is Verdict.RESTART
