"""The tab of messages: a box for each topic that can be drawn, and its settings."""

from collections.abc import Callable
from html import escape
from typing import Any

import viser

from tfbus import messages
from tfbus.view.data.layer import TopicLayer
from tfbus.view.data.topics import POINTS, drawn_type
from tfbus.view.panels.controls import Control
from tfbus.view.panels.markup import Html
from tfbus.view.scene.data import DataScenes
from tfbus.view.settings import RANGES, ViewState
from tfbus.wording import printable

_COLORS = ("auto", "flat", "height")
_IMAGES = (messages.Image, messages.CompressedImage)
_WITHOUT_LOCK = (
    messages.Log,
    messages.Marker,
    messages.MarkerArray,
    messages.OccupancyGrid,
)


class DataPanel:
    """A tab that is there once a topic has been that can be drawn."""

    title = "Data"

    def __init__(
        self, gui: viser.GuiApi, tabs: viser.GuiTabGroupHandle, view: ViewState, scenes: DataScenes
    ) -> None:
        self._gui = gui
        self._tabs = tabs
        self._view = view
        self._scenes = scenes
        self._tab: viser.GuiTabHandle | None = None
        self._rows: dict[str, _TopicRow] = {}

    def refresh(self) -> None:
        """Show the topics, and what is drawn of each."""
        topics = self._scenes.topics
        if topics and self._tab is None:
            self._tab = self._tabs.add_tab(self.title)
        if self._tab is None:
            return
        for topic in [topic for topic in self._rows if topic not in topics]:
            self._scenes.show_picture.pop(topic, None)
            self._rows.pop(topic).remove()
        with self._tab:
            for topic, info in topics.items():
                message_type = drawn_type(info)
                if topic not in self._rows and message_type is not None:
                    self._rows[topic] = _TopicRow(
                        self._gui, self._view, self._scenes, topic, message_type
                    )
        for topic, row in self._rows.items():
            row.refresh(self._scenes.layers.get(topic))


class _TopicRow:
    def __init__(
        self,
        gui: viser.GuiApi,
        view: ViewState,
        scenes: DataScenes,
        topic: str,
        message_type: type,
    ) -> None:
        self._gui = gui
        self._view = view
        self._scenes = scenes
        self._topic = topic
        self._picture: Any = None
        self._quality = 0
        settings = view.settings.of_topic(topic)
        self._box_handle = gui.add_checkbox(
            printable(topic), settings.shown, hint=message_type.__name__
        )
        self._box = Control(self._box_handle, self._setter("shown"))
        self._folder: Any = gui.add_folder(
            f"{printable(topic)}: {message_type.__name__}", visible=settings.shown
        )
        self._controls: dict[str, Control] = {}
        self._color: Any = None
        with self._folder:
            if message_type in POINTS:
                options = tuple(dict.fromkeys((*_COLORS, settings.color)))
                self._color = gui.add_dropdown("Colour", options, initial_value=settings.color)
                self._controls["color"] = Control(self._color, self._setter("color"))
                self._slider("size", "Size (cm)", 0.5)
                self._slider("decay_s", "Decay (s)", 0.5)
                self._slider("voxel", "Voxel (cm)", 1.0)
                self._slider("most_points", "Points at most", 1000.0)
            if message_type in _IMAGES:
                self._slider("quality", "JPEG quality", 5.0)
            if message_type not in _WITHOUT_LOCK:
                self._slider("rate_hz", "At most (Hz)", 0.1)
                self._controls["locked"] = Control(
                    gui.add_checkbox(
                        "Locked to its frame",
                        settings.locked,
                        hint="Moves with its frame, instead of staying at the place of its stamp.",
                    ),
                    self._setter("locked"),
                )
            self._state = Html(gui.add_html(""))
        self._namespaces: dict[str, Control] = {}
        if message_type in _IMAGES:
            scenes.show_picture[topic] = self._show_picture

    def refresh(self, layer: TopicLayer | None) -> None:
        """Follow the settings, and say what is drawn."""
        settings = self._view.settings.of_topic(self._topic)
        self._box.show(settings.shown)
        if self._folder.visible != settings.shown:
            self._folder.visible = settings.shown
        for name, control in self._controls.items():
            control.show(getattr(settings, name))
        if layer is None:
            self._state.show("")
            return
        if self._color is not None and layer.columns:
            columns = map(printable, layer.columns)
            options = tuple(dict.fromkeys((*_COLORS, *columns, settings.color)))
            if self._color.options != options:
                self._color.options = options
        self._state.show(state_of(layer, self._scenes.rejected(self._topic)))
        for name in list(layer.namespaces):
            if name not in self._namespaces:
                with self._folder:
                    label = printable(name, 60) or "(no namespace)"
                    box = self._gui.add_checkbox(label, name not in settings.hidden)
                    self._namespaces[name] = Control(box, self._hider(name))
            self._namespaces[name].show(name not in settings.hidden)

    def _hider(self, namespace: str) -> Callable[[bool], None]:
        def on_choice(is_shown: bool) -> None:
            hidden = self._view.settings.of_topic(self._topic).hidden
            others = tuple(name for name in hidden if name != namespace)
            chosen = others if is_shown else (*others, namespace)
            self._view.change_topic(self._topic, hidden=chosen)

        return on_choice

    def remove(self) -> None:
        """Remove the controls."""
        self._box_handle.remove()
        self._folder.remove()

    def _slider(self, name: str, label: str, step: float) -> None:
        least, most = RANGES[name]
        value = getattr(self._view.settings.of_topic(self._topic), name)
        handle = self._gui.add_slider(label, least, most, step, value)
        self._controls[name] = Control(handle, self._setter(name))

    def _setter(self, name: str) -> Callable[[Any], None]:
        return lambda value: self._view.change_topic(self._topic, **{name: value})

    def _show_picture(self, picture: Any) -> None:
        quality = int(self._view.settings.of_topic(self._topic).quality)
        if self._picture is not None and quality == self._quality:
            self._picture.image = picture
            return
        if self._picture is not None:
            self._picture.remove()
        self._quality = quality
        with self._folder:
            self._picture = self._gui.add_image(picture, format="jpeg", jpeg_quality=quality)


def state_of(layer: TopicLayer, rejected: int = 0) -> str:
    """How many messages were drawn and dropped, and the lines of a log, as HTML."""
    facts = [f"{layer.drawn} drawn"]
    facts += [f"{layer.age_s * 1e3:.0f} ms old"] if layer.age_s is not None else []
    facts += [f"{count} dropped, {reason}" for reason, count in sorted(layer.dropped.items())]
    overtaken = layer.waiting.dropped
    facts += [f"{overtaken} overtaken by newer ones"] if overtaken else []
    facts += [f"{rejected} unreadable"] if rejected else []
    text = f'<div class="tf tf-dim">{escape(" · ".join(facts))}</div>'
    if layer.trouble:
        text += f'<div class="tf tf-alarm" role="alert">{escape(layer.trouble)}</div>'
    lines = [
        f"[{line.level_name.upper()}] [{printable(line.name, 60)}] {printable(line.msg, 300)}"
        for line in layer.lines
    ]
    if lines:
        text += f'<div class="tf"><pre>{escape(chr(10).join(lines[-30:]))}</pre></div>'
    return text
