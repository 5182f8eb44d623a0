"""Where a recording is shown, and how it goes on."""

import pytest

from tests.builders import S
from tfbus.view.model.playhead import SPEEDS, Cursor, Playhead

START, END = 100 * S, 110 * S


@pytest.fixture
def playhead() -> Playhead:
    """At the beginning of ten seconds, and paused."""
    return Playhead(START, END, Cursor(START))


def test_time_passes_while_it_plays_by_its_speed(playhead: Playhead) -> None:
    """And not while it is paused."""
    assert playhead.advance(1.0).at_ns == START
    playhead.set_speed(2.0)
    playhead.toggle()
    assert playhead.advance(1.5).at_ns == START + 3 * S
    playhead.toggle()
    assert playhead.advance(1.0).at_ns == START + 3 * S


def test_it_stops_at_the_end_and_plays_again_from_the_beginning(playhead: Playhead) -> None:
    """As players of films do."""
    playhead.seek(END - S, plays=True)
    assert playhead.advance(2.0) == Cursor(END, plays=False)
    playhead.play(True)
    assert playhead.cursor == Cursor(START, plays=True)


def test_a_loop_begins_again_at_the_end(playhead: Playhead) -> None:
    """Without a stop."""
    playhead.loop(True)
    playhead.seek(END - S, plays=True)
    assert playhead.advance(2.0) == Cursor(START, plays=True, loops=True)


def test_a_recording_of_one_moment_stops_there() -> None:
    """Also where it should loop."""
    playhead = Playhead(START, START, Cursor(START, plays=True, loops=True))
    assert playhead.advance(1.0) == Cursor(START, plays=False, loops=True)


def test_it_stays_within_the_recording(playhead: Playhead) -> None:
    """A seek outside goes to the nearer end."""
    playhead.seek(0)
    assert playhead.cursor.at_ns == START
    playhead.seek(2 * END)
    assert playhead.cursor.at_ns == END
    playhead.seek_by(-3.0)
    assert playhead.cursor.at_ns == END - 3 * S
    assert Playhead(START, END, Cursor(0)).cursor.at_ns == START


@pytest.mark.parametrize(("wanted", "speed"), [(0.0, 0.1), (1.2, 1.0), (4.0, 5.0), (99.0, 10.0)])
def test_a_speed_is_one_of_the_choices(playhead: Playhead, wanted: float, speed: float) -> None:
    """The nearest."""
    playhead.set_speed(wanted)
    assert playhead.cursor.speed == speed


def test_faster_and_slower_go_through_all_speeds(playhead: Playhead) -> None:
    """And stay at the last."""
    playhead.set_speed(SPEEDS[0])
    seen = []
    for _ in SPEEDS:
        seen.append(playhead.cursor.speed)
        playhead.change_speed(1)
    assert tuple(seen) == SPEEDS and playhead.cursor.speed == SPEEDS[-1]
    playhead.change_speed(-1)
    assert playhead.cursor.speed == SPEEDS[-2]


def test_what_browsers_cannot_foresee_is_counted(playhead: Playhead) -> None:
    """Time that passes they know by themselves."""
    playhead.play(True)
    before = playhead.jumps
    playhead.advance(1.0)
    assert playhead.jumps == before
    playhead.seek(START)
    playhead.seek(END - 1, plays=True)
    playhead.advance(1.0)
    assert playhead.jumps == before + 3


def test_steps_pause_and_are_taken_once(playhead: Playhead) -> None:
    """By the one who knows where messages are."""
    playhead.play(True)
    playhead.step(1)
    playhead.step(1)
    assert not playhead.cursor.plays
    assert (playhead.take_steps(), playhead.take_steps()) == (2, 0)
