"""The sliders on a terminal: drawn in place, without taking the whole screen."""

import shutil
import sys

from tfbus import Node
from tfbus.command import KeyReader, RawTerminal

from .board import Board, Posture
from .sliders import Sliders

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
    """Draws the lines over those before; the cursor stays at the first.

    Lines of the log take their place, and they are drawn below it.
    """

    def __init__(self) -> None:
        self._drawn = 0
        self._state: object = None

    def show(self, sliders: Sliders, posture: Posture) -> None:
        """Draw what has changed."""
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
