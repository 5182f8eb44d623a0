"""The rows of the tree of frames, which browsers make anew when one of them changes."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from tfbus import Buffer, FrameInfo

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.frames import Frames, Placed, ViewFrame
from tfbus.view.panels.markup import Channel
from tfbus.view.panels.tree import TreePanel
from tfbus.view.settings import Selections, ViewSettings, ViewState

NO_COMMON_TIME = "no data for 'odom' -> 'base2': its newest sample is {:.3f} s too old"


class Browser:
    """A browser with the tree of one frame."""

    def __init__(self) -> None:
        server = MagicMock()
        server.get_clients.return_value = {1: server}
        server.gui.add_html.side_effect = self._add
        self._elements: list[Any] = []
        view, selections = ViewState(ViewSettings()), Selections("")
        self._tree = TreePanel(server, MagicMock(), view, selections, Channel())

    def _add(self, content: str, order: float) -> Any:
        self._elements.append(SimpleNamespace(content=content))
        return self._elements[-1]

    def rows(self, why: str) -> str:
        """The rows, if the frame has no place for this reason."""
        frame = ViewFrame(FrameInfo("base2", parent="odom"), "stale", 5.0, 0.25, (), "odom", 1)
        placed = Placed((), np.zeros((0, 3)), np.zeros((0, 4)), {"base2": why})
        self._tree.refresh(Frames([frame]), placed, "odom", Buffer(), 0)
        return str(self._elements[0].content)


def test_rows_stay_while_a_time_in_a_reason_grows() -> None:
    """By 15 %: over a minute in steps of a quarter of a second they change less than 20 times."""
    browser = Browser()
    now_s = 5.0 + np.arange(240) / 4
    found = [browser.rows(NO_COMMON_TIME.format(each)) for each in now_s]
    assert sum(one != other for one, other in pairwise(found)) < 20
    written_s = [float(rows.partition("sample is ")[2].partition(" s")[0]) for rows in found]
    assert (np.abs(now_s - written_s) <= 0.15 * np.array(written_s)).all()


def test_another_reason_is_said_at_once() -> None:
    """Also if it is that of a frame whose name has another number."""
    browser = Browser()
    browser.rows(NO_COMMON_TIME.format(5.0))
    assert "base3" in browser.rows(NO_COMMON_TIME.format(5.0).replace("base2", "base3"))
    assert "is not connected" in browser.rows("'base2' is not connected to 'map'")
