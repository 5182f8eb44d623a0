"""Sliders for the joints of a robot, and the screen that shows them."""

import shutil
import sys

from tfbus import Node
from tfbus.base.wording import columns, counted, cut, printable
from tfbus.command.terminal import KeyReader, RawTerminal

from .board import Board, Posture
from .ranges import Range

_HELP = "↑↓ joint  ←→ move  [ ] finely  0 this one to rest  z all  r random  q quit"

# A key moves a joint by this part of its range.
_STEPS = {"left": -0.02, "right": 0.02, "[": -0.002, "]": 0.002}

_LONGEST_NAME = 26
_SHORTEST_BAR = 5

_BOLD, _FAINT, _END = "\x1b[1m", "\x1b[2m", "\x1b[0m"


class Sliders:
    """The chosen joint of a board, and the keys that move it."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._chosen = 0
        self._top = 0

    @property
    def chosen(self) -> str:
        """The joint that keys move; "" if there is none."""
        return self._chosen_of(list(self._board.posture.ranges))

    def press(self, key: str) -> None:
        """Follow a key; unknown ones are ignored."""
        board, posture = self._board, self._board.posture
        chosen = self._chosen_of(list(posture.ranges))
        if not chosen:
            return
        each = posture.ranges[chosen]
        if key in _STEPS:
            board.set({chosen: posture.positions[chosen] + _STEPS[key] * each.width})
        elif key in ("up", "down"):
            count = len(posture.ranges)
            self._chosen = (min(self._chosen, count - 1) + (1 if key == "down" else -1)) % count
        elif key == "0":
            board.set({chosen: each.rest})
        elif key == "z":
            board.rest()
        elif key == "r":
            board.randomise()

    def lines(self, width: int, height: int) -> list[str]:
        """The screen, at most `height` lines of at most `width` columns."""
        posture = self._board.posture
        if posture.robot is None:
            return [cut("Waiting for a robot on topic robot_description", width)]
        names = list(posture.ranges)
        title = f"{printable(posture.robot.name, 40)}: {counted(len(names), 'joint')}"
        above = [f"{_BOLD}{cut(title, width)}{_END}", f"{_FAINT}{cut(_HELP, width)}{_END}"]
        room = max(1, height - len(above))
        if len(names) > room:
            room = max(1, room - 1)
        chosen = min(self._chosen, max(len(names) - 1, 0))
        self._top = max(chosen - room + 1, min(self._top, chosen, max(0, len(names) - room)))
        shown, marked = names[self._top : self._top + room], self._chosen_of(names)
        longest = min(_LONGEST_NAME, max(map(columns, map(printable, names)), default=0))
        rows = [
            _row(posture.ranges[name], posture.positions[name], name == marked, longest, width)
            for name in shown
        ]
        if len(shown) < len(names):
            first, last = self._top + 1, self._top + len(shown)
            rows.append(f"{_FAINT}{cut(f'  {first} to {last} of {len(names)}', width)}{_END}")
        return above + rows

    def _chosen_of(self, names: list[str]) -> str:
        return names[min(self._chosen, len(names) - 1)] if names else ""


def _row(each: Range, position: float, is_chosen: bool, longest: int, width: int) -> str:
    name = cut(printable(each.name), longest)
    unit = "rad" if each.turns else "m"
    before = f"{'>' if is_chosen else ' '} {name}{' ' * (longest - columns(name))} "
    before += f"{position:8.3f} {unit:<3} {each.lower:7.2f} "
    after = f" {each.upper:.2f}"
    room = width - columns(before) - max(len(after), 6)
    text = before + _bar(each, position, room) + after if room >= _SHORTEST_BAR else before
    text = cut(text, width)
    return f"{_BOLD}{text}{_END}" if is_chosen else text


def _bar(each: Range, position: float, length: int) -> str:
    part = (position - each.lower) / each.width if each.width else 0.0
    at = round(part * (length - 1))
    return "─" * at + "●" + "─" * (length - 1 - at)


# How often other programs' changes are shown.
_PAUSE_S = 0.1

_QUIT = ("q", "Q", "\x03")
_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"


def run_sliders(node: Node, terminal: RawTerminal, board: Board) -> None:
    """Follow the keys until one of them quits, or the node is shut down."""
    sliders, keys, screen = Sliders(board), KeyReader(), _Screen()
    try:
        screen.write(_HIDE_CURSOR)
        while node.ok:
            screen.show(sliders, board.posture)
            data = terminal.read(_PAUSE_S)
            for key in keys.feed(data) if data else keys.flush():
                if key in _QUIT:
                    return
                sliders.press(key)
    finally:
        screen.leave()


class _Screen:
    """Draws the lines over the former ones; the cursor stays at the first.

    Lines of the log take their place, and they are drawn below it.
    """

    def __init__(self) -> None:
        self._drawn = 0
        self._state: object = None

    def show(self, sliders: Sliders, posture: Posture) -> None:
        """Draw the lines if they have changed."""
        size = shutil.get_terminal_size()
        state = (posture, sliders.chosen, size)
        if state == self._state:
            return
        # The line below the last takes one more.
        lines = sliders.lines(size.columns, size.lines - 1)
        self._drawn, self._state = len(lines), state
        self.write("\r\x1b[J" + "".join(f"{line}\n" for line in lines) + f"\x1b[{self._drawn}A")

    def leave(self) -> None:
        """Put the cursor below the lines, and show it."""
        self.write("\n" * self._drawn + _SHOW_CURSOR)

    @staticmethod
    def write(text: str) -> None:
        """Write to the terminal at once."""
        sys.stdout.write(text)
        sys.stdout.flush()
