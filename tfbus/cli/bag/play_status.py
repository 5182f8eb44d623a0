"""The display of `tfbus bag play` while it plays."""

from tfbus.cli.bag.record_status import StatusLine
from tfbus.cli.output import paint, width
from tfbus.recording.playhead import Progress
from tfbus.wording import counted, cut, duration

# The shortest and the longest bar, in characters.
_SHORTEST, _LONGEST = 10, 60

_ERASE_LINE = "\r\x1b[K"

# Who is behind by less is not too slow.
_LATE_NS = 1_000_000_000


class PlayLine(StatusLine):
    """A line of a terminal: state, time, bar, rate."""

    def show_progress(self, progress: Progress) -> None:
        """Show how far it is."""
        state, rest = state_of(progress), bar_text(progress, width() - 1)
        self._shown = True
        role = "warning" if progress.is_paused else "good"
        self._write(f"{_ERASE_LINE}{paint(state, role)}{rest[len(state) :]}")


def state_of(progress: Progress) -> str:
    """Its state: `playing`."""
    return "paused " if progress.is_paused else "playing"


def bar_text(progress: Progress, columns: int) -> str:
    """The line in at most this many columns: `playing   12.3 / 60.0 s [===>      ] 1x`."""
    all_s = f"{progress.duration_s:.1f}"
    head = f"{state_of(progress)} {progress.played_s:{len(all_s)}.1f} / {all_s} s"
    tail = [f"{progress.rate:g}x"]
    if progress.loops:
        tail.append(f"loop {progress.loops}")
    if progress.late_ns > _LATE_NS:
        tail.append(f"{progress.late_ns / 1e9:.0f} s behind")
    room = columns - len(head) - len("  ".join(tail)) - 4
    if room >= _SHORTEST:
        head += f" {_bar(progress, min(room, _LONGEST))}"
    return cut("  ".join([f"{head} {tail[0]}", *tail[1:]]), columns)


def _bar(progress: Progress, columns: int) -> str:
    part = progress.played_s / progress.duration_s if progress.duration_s > 0.0 else 1.0
    done = round(min(max(part, 0.0), 1.0) * columns)
    head = "=" * (done - 1) + ">" if 0 < done < columns else "=" * done
    return f"[{head:<{columns}}]"


def log_text(progress: Progress) -> str:
    """The line of the log that says every now and then how far it is."""
    state = "Paused at" if progress.is_paused else "At"
    again = f", loop {progress.loops}" if progress.loops else ""
    return (
        f"{state} {progress.played_s:.1f} of {progress.duration_s:.1f} s, "
        f"rate {progress.rate:g}{again}"
    )


def end_text(progress: Progress, running_s: float) -> str:
    """The summary of a replay."""
    text = f"Played {counted(progress.sent, 'message')} in {duration(running_s)}"
    if progress.late_ns > _LATE_NS:
        text += (
            f"; this machine was too slow for rate {progress.rate:g}, by "
            f"{duration(progress.late_ns / 1e9)} in all"
        )
    return text
