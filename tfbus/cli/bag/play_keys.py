"""The keys of `tfbus bag play`, those of ros2 bag if it has the same."""

from collections.abc import Callable

from tfbus.recording.playhead import Playhead, nearest_rate

KEYS = (
    "space pauses, . plays one message, , the one before, left and right seek 5 s, up and down "
    "change the rate, q ends"
)

_SEEK_S = 5.0

# One press makes it faster by a tenth.
_FASTER = 1.1


def follow(key: str, player: Playhead) -> bool:
    """Do what a key is for; whether to go on."""
    jobs: dict[str, Callable[[], object]] = {
        " ": player.toggle_paused,
        ".": player.step,
        ",": lambda: player.step(-1),
        "right": lambda: player.seek_by(_SEEK_S),
        "left": lambda: player.seek_by(-_SEEK_S),
        "up": lambda: _change_rate(player, _FASTER),
        "down": lambda: _change_rate(player, 1.0 / _FASTER),
    }
    if key in jobs:
        jobs[key]()
    return key not in ("q", "Q", "\x03")


def _change_rate(player: Playhead, factor: float) -> None:
    player.set_rate(nearest_rate(round(player.progress.rate * factor, 4)))
