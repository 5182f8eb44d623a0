"""The poses of a frame over time, drawn by matplotlib."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tfbus.errors import TfbusError
from tfbus.frames.picture import drawing
from tfbus.frames.track import angular_speed, gaps_of, linear_speed, rpy_rad, seconds_of
from tfbus.runtime.whole_file import replacing
from tfbus.trajectory.trajectory import Trajectory

Panel = Literal["position", "orientation", "speed", "path"]
PANELS: tuple[Panel, ...] = get_args(Panel)

_COLOURS = ("#dc2626", "#16a34a", "#2563eb")  # x, y and z, as RViz has them
_GREY = "#6b7280"
_SIZE = (5.2, 3.4)

# As the view: beyond, matplotlib has no axis.
_FARTHEST_M = 1e15

# The least that an axis spans: a frame at rest is a straight line, not the noise of rounding.
_LEAST_M, _LEAST_DEGREES = 0.001, 0.1
_LEAST_M_PER_S, _LEAST_RAD_PER_S = 0.001, 0.001


def draw(track: Trajectory, panels: tuple[Panel, ...]) -> Any:
    """A matplotlib Figure with the panels, two in a row."""
    from matplotlib.figure import Figure

    figure = Figure()
    _draw_into(figure, track, panels)
    return figure


def write_plot(track: Trajectory, path: Path, panels: tuple[Panel, ...]) -> None:
    """Draw the panels into a file, whose ending chooses one of matplotlib's formats.

    A failure leaves the file as it was.
    """
    with drawing(), replacing(path) as file:
        draw(track, panels).savefig(file, format=path.suffix[1:], dpi=150)


def show_plot(track: Trajectory, panels: tuple[Panel, ...]) -> None:
    """Draw the panels into a window; returns when it is closed.

    Raises TfbusError if matplotlib has no toolkit to open one with.
    """
    from matplotlib import pyplot

    figure = pyplot.figure(f"{track.child_frame_id} seen from {track.frame_id}")
    if pyplot.get_backend().lower() == "agg":  # its choice when it finds no toolkit
        raise TfbusError(
            "there is no toolkit to open a window with: write a file with -o, or install one, "
            "such as Debian's python3-tk, or pip install pyqt6"
        )
    with drawing():
        _draw_into(figure, track, panels)
        pyplot.show()


def _draw_into(figure: Any, track: Trajectory, panels: tuple[Panel, ...]) -> None:
    if not (np.abs(track.xyz) <= _FARTHEST_M).all():
        raise TfbusError(
            f"{track.child_frame_id!r} is farther than 1e15 m away: that cannot be plotted"
        )
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure.set_size_inches(_SIZE[0] * columns, _SIZE[1] * rows + 0.5)
    figure.set_layout_engine("constrained")
    first = datetime.fromtimestamp(int(track.stamps_ns[0]) / 1e9, tz=UTC)
    name = f"{track.child_frame_id} seen from {track.frame_id}".replace("$", r"\$")
    figure.suptitle(f"{name}, from {first:%Y-%m-%d %H:%M:%S} UTC", fontsize=11)
    for number, panel in enumerate(panels, start=1):
        axes = figure.add_subplot(rows, columns, number)
        axes.grid(visible=True, color="#e5e7eb", linewidth=0.6)
        axes.set_axisbelow(True)
        _DRAW[panel](axes, track)


def _draw_position(axes: Any, track: Trajectory) -> None:
    seconds = broken(track, seconds_of(track))
    for values, name, colour in zip(broken(track, track.xyz).T, "xyz", _COLOURS, strict=True):
        axes.plot(seconds, values, color=colour, label=name, linewidth=1.3)
    _widen(axes, "y", _LEAST_M)
    _label(axes, "position (m)")


def _draw_orientation(axes: Any, track: Trajectory) -> None:
    seconds, degrees = (
        broken(track, each) for each in (seconds_of(track), np.degrees(rpy_rad(track)))
    )
    names = ("roll", "pitch", "yaw")
    for values, name, colour in zip(degrees.T, names, _COLOURS, strict=True):
        axes.plot(seconds, values, color=colour, label=name, linewidth=1.3)
    _widen(axes, "y", _LEAST_DEGREES)
    _label(axes, "orientation (degrees)")


def _draw_speed(axes: Any, track: Trajectory) -> None:
    between = (seconds_of(track)[1:] + seconds_of(track)[:-1]) / 2
    is_gap = gaps_of(track)
    linear, turning = (
        np.where(is_gap, np.nan, each) for each in (linear_speed(track), angular_speed(track))
    )
    axes.plot(between, linear, color="#111827", label="linear", linewidth=1.3)
    angular = axes.twinx()
    angular.plot(between, turning, color="#d97706", label="angular", linewidth=1.0, alpha=0.9)
    angular.set_ylabel("angular speed (rad/s)", color="#d97706", fontsize=9)
    angular.tick_params(labelsize=8)
    # Keeps lines of constant speed visible, beside each other and at zero.
    for each, least, room in ((axes, _LEAST_M_PER_S, 1.1), (angular, _LEAST_RAD_PER_S, 1.3)):
        top = room * max(each.dataLim.y1, least)
        each.set_ylim(-0.03 * top, top)
    axes.set_ylabel("linear speed (m/s)", fontsize=9)
    axes.set_xlabel("seconds", fontsize=9)
    axes.tick_params(labelsize=8)


def _draw_path(axes: Any, track: Trajectory) -> None:
    x, y = track.xyz[:, 0], track.xyz[:, 1]
    axes.plot(*broken(track, track.xyz[:, :2]).T, color="#2563eb", linewidth=1.4)
    axes.plot(x[0], y[0], "o", color="#16a34a", markersize=6, label="first")
    axes.plot(x[-1], y[-1], "s", color="#dc2626", markersize=6, label="last")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    _widen(axes, "x", _LEAST_M)
    _widen(axes, "y", _LEAST_M)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel("x (m)", fontsize=9)
    axes.set_ylabel("y (m)", fontsize=9)
    axes.set_title("path from above", fontsize=9, color=_GREY)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="best")


def broken(track: Trajectory, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values with one in each gap that is not drawn: nothing is known of the time between."""
    return np.insert(values, np.flatnonzero(gaps_of(track)) + 1, np.nan, axis=0)


def _widen(axes: Any, side: Literal["x", "y"], least: float) -> None:
    """Widen an axis around the data to span at least `least`, and write its numbers in full."""
    low, high = getattr(axes.dataLim, f"interval{side}")
    if high - low < least:
        middle = (low + high) / 2
        ends = np.array([[middle - least / 2] * 2, [middle + least / 2] * 2])
        axes.update_datalim(ends, updatex=side == "x", updatey=side == "y")
        axes.autoscale_view()
    axes.ticklabel_format(axis=side, useOffset=False)


def _label(axes: Any, text: str) -> None:
    axes.set_ylabel(text, fontsize=9)
    axes.set_xlabel("seconds", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="best")


_DRAW = {
    "position": _draw_position,
    "orientation": _draw_orientation,
    "speed": _draw_speed,
    "path": _draw_path,
}
