"""The playhead: its place in a recording, its pace, and its commands."""

import pytest

from tests.builders import S
from tests.fakes import StandingClock
from tfbus.base.errors import InvalidArgumentException
from tfbus.recording.playhead import AtEnd, Playhead, Progress

START, END = 100 * S, 110 * S


@pytest.fixture
def clock() -> StandingClock:
    """Goes on by `pass_time` only."""
    return StandingClock()


@pytest.fixture
def playhead(clock: StandingClock) -> Playhead:
    """Paused at the beginning of ten seconds."""
    return made(clock)


def made(
    clock: StandingClock, end_ns: int = END, at_end: AtEnd = "wait", paused: bool = True
) -> Playhead:
    """A playhead from START on."""
    return Playhead(START, end_ns, paused=paused, at_end=at_end, clock=clock)


def pass_time(clock: StandingClock, playhead: Playhead, seconds: float) -> Progress:
    """The progress so much later."""
    clock.at_ns += round(seconds * S)
    return playhead.advance()


def place(progress: Progress) -> tuple[int, bool]:
    """The place of the playhead, and whether it plays."""
    return progress.log_ns, not progress.is_paused


def test_time_passes_while_it_plays_by_its_rate(clock: StandingClock, playhead: Playhead) -> None:
    """Paused it stands."""
    assert pass_time(clock, playhead, 1.0).log_ns == START
    playhead.set_rate(2.0)
    playhead.toggle_paused()
    assert pass_time(clock, playhead, 1.5).log_ns == START + 3 * S
    playhead.toggle_paused()
    assert pass_time(clock, playhead, 1.0).log_ns == START + 3 * S


def test_it_stops_at_the_end_and_plays_again_from_the_beginning(
    clock: StandingClock, playhead: Playhead
) -> None:
    """Also if it was sought there."""
    playhead.seek(END - S, paused=False)
    assert place(pass_time(clock, playhead, 2.0)) == (END, False)
    playhead.resume()
    assert place(playhead.advance()) == (START, True)
    playhead.seek(END, paused=True)
    playhead.resume()
    assert place(playhead.progress) == (START, True)


def test_a_loop_begins_again_at_the_end(clock: StandingClock, playhead: Playhead) -> None:
    """At the moment when it came there, and is counted; taken back, it stands at the end."""
    playhead.loop(True)
    playhead.seek(END - S, paused=False)
    progress = pass_time(clock, playhead, 2.0)
    assert (place(progress), progress.loops) == ((START + S, True), 2)
    playhead.loop(False)
    progress = pass_time(clock, playhead, 20.0)
    assert (place(progress), progress.loops) == ((END, False), 0)


def test_a_loop_of_one_moment_ends(clock: StandingClock) -> None:
    """It would begin again for ever."""
    playhead = made(clock, START, "loop", paused=False)
    assert place(pass_time(clock, playhead, 1.0)) == (START, False)


def test_it_stays_within_the_recording(clock: StandingClock, playhead: Playhead) -> None:
    """A time beyond it is that of its end."""
    playhead.seek(0)
    assert playhead.progress.log_ns == START
    playhead.seek(2 * END)
    assert playhead.progress.log_ns == END
    playhead.seek_by(-3.0)
    assert playhead.progress.log_ns == END - 3 * S
    assert Playhead(START, END, at_ns=0, paused=True).progress.log_ns == START


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1e9])
def test_a_rate_without_a_meaning_is_refused(playhead: Playhead, rate: float) -> None:
    """It stays as it was."""
    with pytest.raises(InvalidArgumentException, match=r"0\.001 to 10,000"):
        playhead.set_rate(rate)
    assert playhead.progress.rate == 1.0


def test_what_nobody_can_foresee_is_counted(clock: StandingClock, playhead: Playhead) -> None:
    """Not the time that passes."""
    playhead.resume()
    before = playhead.jumps
    pass_time(clock, playhead, 1.0)
    assert playhead.jumps == before
    playhead.seek(START)
    playhead.seek(END - 1)
    pass_time(clock, playhead, 1.0)
    assert playhead.jumps == before + 3


def test_steps_pause_and_are_taken_once(clock: StandingClock, playhead: Playhead) -> None:
    """Whatever came between two pictures."""
    playhead.resume()
    playhead.step(1)
    playhead.step(1)
    assert playhead.progress.is_paused
    assert (playhead.take_steps(), playhead.take_steps()) == (2, 0)
