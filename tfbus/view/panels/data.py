"""The tab of messages: a box for each topic that can be drawn, and settings of ticked topics."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from html import escape
from typing import Any

import viser

from tfbus import messages
from tfbus.base.wording import printable
from tfbus.bus.graph import TopicInfo
from tfbus.view.data.layer import MOST_DECAYING_POINTS, TopicLayer
from tfbus.view.data.shapes import RGB_OF
from tfbus.view.data.topics import POINTS, drawn_type
from tfbus.view.panels.controls import Control
from tfbus.view.panels.markup import Channel, Html, event
from tfbus.view.scene.data import DataScenes
from tfbus.view.settings import POSES, RANGES, TopicSettings, ViewSettings, ViewState, topic_of
from tfbus.wire.keys import namespace_of_node

_COLORS = ("auto", "flat", "height")
_MAP_COLORS = ("auto", "costmap")
_IMAGES = (messages.Image, messages.CompressedImage)
_POSES = (
    messages.Odometry,
    messages.Path,
    messages.PoseArray,
    messages.PoseStamped,
    messages.PoseWithCovarianceStamped,
)
_LINES = (messages.Path, messages.PolygonStamped)
_ARROWS = (*_POSES, messages.PointStamped)
_SEE_THROUGH = (*_ARROWS, messages.OccupancyGrid, messages.Range)
_SCALED = (*_ARROWS, *_IMAGES)
_WITHOUT_LOCK = (
    messages.Log,
    messages.Marker,
    messages.MarkerArray,
    messages.OccupancyGrid,
)


class DataPanel:
    """A tab that is there once a topic has been that can be drawn.

    It lists the topics, and below them has the settings of ticked topics, the last at the end.
    """

    title = "Data"

    def __init__(
        self,
        gui: viser.GuiApi,
        tabs: viser.GuiTabGroupHandle,
        view: ViewState,
        scenes: DataScenes,
        channel: Channel,
    ) -> None:
        self._gui = gui
        self._tabs = tabs
        self._view = view
        self._scenes = scenes
        self._tab: viser.GuiTabHandle | None = None
        self._find: Any = None
        self._list: Html | None = None
        self._rows: dict[str, _TopicRow] = {}
        channel.on("topic", self._tick)
        channel.on("again", lambda e: self._if_there(e, view.show_again))
        channel.on("forget", lambda e: self._if_there(e, view.forget_topic))
        channel.on(
            "group", lambda e: view.tick("hidden_groups", str(e.get("group", "")), not e.get("on"))
        )

    def refresh(self) -> None:
        """Show the topics, and the counts of each."""
        topics = self._scenes.topics
        if topics and self._tab is None:
            self._tab = self._tabs.add_tab(self.title)
            with self._tab:
                self._find = self._gui.add_text("Find", "", visible=False)
                self._list = Html(self._gui.add_html(""))
        if self._tab is None or self._list is None:
            return
        settings = self._view.settings
        self._list.show(topics_html(topics, settings, self._find.value))
        if self._find.visible != (len(topics) > _MOST_AT_A_GLANCE):
            self._find.visible = not self._find.visible
        # Those of hidden groups too: a group that is typed may be one on the way.
        shown = {each.topic for each in settings.topics if each.shown} & topics.keys()
        for topic in [topic for topic in self._rows if topic not in shown]:
            self._scenes.show_picture.pop(topic, None)
            self._rows.pop(topic).remove()
        with self._tab:
            for topic, info in topics.items():
                message_type = drawn_type(info)
                if topic in shown and topic not in self._rows and message_type is not None:
                    self._rows[topic] = _TopicRow(
                        self._gui, self._view, self._scenes, topic, message_type
                    )
        for topic, row in self._rows.items():
            row.refresh(self._scenes.layers.get(topic))

    def _tick(self, event: Mapping[str, Any]) -> None:
        topic = event.get("topic")
        if isinstance(topic, str) and topic in self._scenes.topics:
            self._view.change_topic(topic, shown=event.get("on") is True)

    def _if_there(self, event: Mapping[str, Any], act: Callable[[str], None]) -> None:
        topic = event.get("topic")
        if isinstance(topic, str) and topic in self._rows:
            act(topic)


# With more topics there is a field to find some.
_MOST_AT_A_GLANCE = 12


def robots_of(topics: Mapping[str, TopicInfo]) -> dict[str, str]:
    """The namespace of the robot of each topic, "" for none: one in which a node publishes that."""
    robots = set()
    for topic, info in topics.items():
        spaces = [f"/{namespace_of_node(end.node)}" for end in info.publishers]
        above = topic.strip("/").rpartition("/")[0]
        while above and not any(space.endswith(f"/{above}") for space in spaces):
            above = above.rpartition("/")[0]
        robots.add(above)
    return {topic: _longest_above(topic, robots) for topic in topics}


def _longest_above(topic: str, robots: Collection[str]) -> str:
    above = [each for each in robots if topic.strip("/").startswith(f"{each}/")]
    return max(above, key=len, default="")


def topics_html(topics: Mapping[str, TopicInfo], settings: ViewSettings, find: str = "") -> str:
    """A box for each topic whose name or type has the text `find` in it: shown topics of no group
    first, then group by group, then topics of no robot, then robot by robot, all by name. A group
    has a box for all of it.
    """
    robots = robots_of(topics)
    types = {topic: drawn_type(info) for topic, info in topics.items()}
    named = {topic: kind.__name__ for topic, kind in types.items() if kind is not None}
    sought = find.strip().lower()
    chosen = {topic: settings.of_topic(topic) for topic in named}
    found = [
        topic
        for topic, kind in named.items()
        if any(sought in text.lower() for text in (topic, kind, chosen[topic].group))
    ]
    parts: dict[tuple[int, str], list[str]] = {}
    for topic in sorted(found):
        parts.setdefault(_part_of(chosen[topic], robots[topic]), []).append(topic)
    count = len(named.keys() & settings.drawn.keys())
    lines = [f'<div class="tf-dim">{count} of {len(named)} drawn</div>']
    for part, members in sorted(parts.items()):
        shown = [topic for topic in members if chosen[topic].shown]
        lines.append(_heading(part, settings, f"{len(shown)} of {len(members)}"))
        boxes = [_box(topic, named[topic], is_shown=topic in shown) for topic in members]
        kind = "tf-members" if part[0] == _IN_GROUP else ""
        lines.append(f'<div class="{kind}">{"".join(boxes)}</div>')
    if not found:
        lines.append(f'<div class="tf-dim">No topic has {escape(repr(find.strip()))} in it.</div>')
    return f'<div class="tf" role="group" aria-label="topics">{"".join(lines)}</div>'


# The parts of the list, in their order.
_SHOWN, _IN_GROUP, _OTHERS = range(3)


def _part_of(settings: TopicSettings, robot: str) -> tuple[int, str]:
    """The part of the list that a topic is in, and its name."""
    if settings.group:
        return _IN_GROUP, settings.group
    return (_SHOWN, "") if settings.shown else (_OTHERS, robot)


def _heading(part: tuple[int, str], settings: ViewSettings, count: str) -> str:
    kind, name = part
    told = escape(printable(name))
    if kind != _IN_GROUP:
        return f'<div class="tf-robot-name"><b>{told}</b></div>' if name else ""
    tick = event("group", group="this.dataset.group", on="this.checked")
    checked = "" if name in settings.hidden_groups else "checked"
    return (
        f'<label class="tf-row tf-robot-name"><input type="checkbox" aria-label="group {told}" '
        f'{checked} data-group="{escape(name)}" onclick="{tick}"><b class="tf-topic">{told}</b>'
        f'<span class="tf-note">{count}</span></label>'
    )


def _box(topic: str, kind: str, *, is_shown: bool) -> str:
    name, told = escape(topic), escape(printable(topic))
    tick = event("topic", topic="this.dataset.topic", on="this.checked")
    return (
        f'<label class="tf-row" title="{told}"><input type="checkbox" aria-label="{told}" '
        f'{"checked" if is_shown else ""} data-topic="{name}" onclick="{tick}">'
        f'<span class="tf-topic">{told}</span><span class="tf-note">{escape(kind)}</span></label>'
    )


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
        self._folder: Any = gui.add_folder(f"{printable(topic)}: {message_type.__name__}")
        self._controls: dict[str, Control] = {}
        self._color: Any = None
        self._bounds: dict[str, NumberOrAuto] = {}
        with self._folder:
            if message_type in POINTS:
                options = tuple(dict.fromkeys((*_COLORS, settings.color)))
                self._color = gui.add_dropdown("Colour", options, initial_value=settings.color)
                self._controls["color"] = Control(self._color, self._setter("color"))
                for name, label in (("color_min", "Colours from"), ("color_max", "Colours to")):
                    self._bounds[name] = NumberOrAuto(gui, label, self._setter(name))
                self._number("size", "Size (cm)", 0.1)
                self._slider(
                    "pixels", "Size (pixels)", 0.5, "0: so wide as Size (cm) says, in the scene."
                )
                self._number("decay_s", "Decay (s)", 1.0)
                self._slider("voxel", "Voxel (cm)", 1.0)
                self._number("most_points", "Points at most", 1000.0)
            if message_type is messages.OccupancyGrid:
                self._choice("color", "Colour", (*_MAP_COLORS, settings.color))
            self._own_rgb = RGB_OF.get(message_type)
            self._rgb: Control | None = None
            if self._own_rgb is not None:
                label = "Flat colour" if message_type in POINTS else "Colour"
                picker = gui.add_rgb(label, settings.painted(self._own_rgb))
                self._rgb = Control(picker, self._paint)
            if message_type in _LINES:
                self._number("width", "Line width (cm)", 0.5, "0: some pixels.")
            if message_type in _POSES:
                self._choice("poses", "Poses", POSES)
            if message_type in _SEE_THROUGH:
                self._slider("opacity", "Opacity", 0.05)
            if message_type in _SCALED:
                self._slider("scale", "Scale", 0.1)
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
            self._text("group", "Group", "Topics of one group are drawn, or not, together.")
            self._state = Html(gui.add_html(""))
        self._namespaces: dict[str, Control] = {}
        if message_type in _IMAGES:
            scenes.show_picture[topic] = self._show_picture

    def refresh(self, layer: TopicLayer | None) -> None:
        """Follow the settings, and show the layer's counts."""
        settings = self._view.settings.of_topic(self._topic)
        for name, control in self._controls.items():
            control.show(getattr(settings, name))
        if self._rgb is not None and self._own_rgb is not None:
            self._rgb.show(settings.painted(self._own_rgb))
        for name, bound in self._bounds.items():
            bound.show(getattr(settings, name))
        links = links_of(self._topic)
        if layer is None:
            self._state.show(links)
            return
        if self._color is not None and layer.columns:
            columns = map(printable, layer.columns)
            options = tuple(dict.fromkeys((*_COLORS, *columns, settings.color)))
            if self._color.options != options:
                self._color.options = options
        mistakes = [each.mistake for each in self._bounds.values() if each.mistake]
        rejected = self._scenes.rejected(self._topic)
        self._state.show(links + state_of(layer, rejected, mistakes))
        for name in list(layer.namespaces):
            if name not in self._namespaces:
                with self._folder:
                    label = printable(name, 60) or "(no namespace)"
                    box = self._gui.add_checkbox(label, name not in settings.hidden)
                    self._namespaces[name] = Control(box, self._hider(name))
            self._namespaces[name].show(name not in settings.hidden)

    def _paint(self, rgb: tuple[int, int, int]) -> None:
        chosen = "" if rgb == self._own_rgb else f"#{bytes(rgb).hex()}"
        self._view.change_topic(self._topic, rgb=chosen)

    def _hider(self, namespace: str) -> Callable[[bool], None]:
        def on_choice(is_shown: bool) -> None:
            hidden = self._view.settings.of_topic(self._topic).hidden
            others = tuple(name for name in hidden if name != namespace)
            chosen = others if is_shown else (*others, namespace)
            self._view.change_topic(self._topic, hidden=chosen)

        return on_choice

    def remove(self) -> None:
        """Remove the controls."""
        self._folder.remove()

    def _slider(self, name: str, label: str, step: float, hint: str | None = None) -> None:
        least, most = RANGES[name]
        value = getattr(self._view.settings.of_topic(self._topic), name)
        handle = self._gui.add_slider(label, least, most, step, value, hint=hint)
        self._controls[name] = Control(handle, self._setter(name))

    def _number(self, name: str, label: str, step: float, hint: str | None = None) -> None:
        """A field for numbers that a slider shows too roughly, or without room for their digits."""
        least, most = RANGES[name]
        value = getattr(self._view.settings.of_topic(self._topic), name)
        handle = self._gui.add_number(label, value, min=least, max=most, step=step, hint=hint)
        self._controls[name] = Control(handle, self._setter(name))

    def _choice(self, name: str, label: str, options: tuple[str, ...]) -> None:
        value = getattr(self._view.settings.of_topic(self._topic), name)
        options = tuple(dict.fromkeys(options))
        handle: Any = self._gui.add_dropdown(label, options, initial_value=value)
        self._controls[name] = Control(handle, self._setter(name))

    def _text(self, name: str, label: str, hint: str) -> None:
        value = getattr(self._view.settings.of_topic(self._topic), name)
        handle = self._gui.add_text(label, value, hint=hint)
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


class NumberOrAuto:
    """A field for a number, or for "auto", which is None."""

    def __init__(
        self, gui: viser.GuiApi, label: str, on_choice: Callable[[float | None], object]
    ) -> None:
        self._label = label
        self._on_choice = on_choice
        self._handle: Any = gui.add_text(label, _AUTO, hint="A number, or auto: by the message.")
        Control(self._handle, self._typed)

    def show(self, value: float | None) -> None:
        """Show the value that holds, but let a half typed text stay."""
        if not self.mistake and _number_or_auto(self._handle.value) != value:
            self._handle.value = _AUTO if value is None else f"{value:g}"

    @property
    def mistake(self) -> str:
        """The mistake in the text, as a sentence; "" for none."""
        try:
            _number_or_auto(self._handle.value)
        except ValueError:
            text = printable(self._handle.value, 40)
            return f"{self._label}: {text!r} is neither a number nor auto; the colours stay"
        return ""

    def _typed(self, text: str) -> None:
        if not self.mistake:
            self._on_choice(_number_or_auto(text))


_AUTO = "auto"


def _number_or_auto(text: str) -> float | None:
    """The number in a text; None for "auto" or nothing. Raises ValueError."""
    if text.strip() in ("", _AUTO):
        return None
    number = float(text)
    if not math.isfinite(number):
        raise ValueError("not finite")
    return number


def links_of(topic: str) -> str:
    """The links to show a topic once more, and to remove what shows it once more, as HTML."""
    links = {"again": "Show once more"}
    links |= {"forget": "Remove"} if topic != topic_of(topic) else {}
    buttons = " · ".join(
        f'<button class="tf-link" data-topic="{escape(topic)}" '
        f'onclick="{event(do, topic="this.dataset.topic")}">{label}</button>'
        for do, label in links.items()
    )
    return f'<div class="tf">{buttons}</div>'


def state_of(layer: TopicLayer, rejected: int = 0, mistakes: Sequence[str] = ()) -> str:
    """How many messages were drawn and dropped, mistakes, and the lines of a log, as HTML."""
    facts = [f"{layer.drawn} drawn"]
    facts += [f"{layer.age_s * 1e3:.0f} ms old"] if layer.age_s is not None else []
    facts += [f"coloured from {layer.span[0]:.4g} to {layer.span[1]:.4g}"] if layer.span else []
    facts += [f"{count} dropped, {reason}" for reason, count in sorted(layer.dropped.items())]
    overtaken = layer.waiting.dropped
    facts += [f"{overtaken} overtaken by newer ones"] if overtaken else []
    facts += [f"{rejected} unreadable"] if rejected else []
    facts += [f"the newest {MOST_DECAYING_POINTS} points stay"] if layer.is_cut else []
    text = f'<div class="tf tf-dim">{escape(" · ".join(facts))}</div>'
    for mistake in (*mistakes, *([layer.trouble] if layer.trouble else [])):
        text += f'<div class="tf tf-alarm" role="alert">{escape(mistake)}</div>'
    lines = [
        f"[{line.level_name.upper()}] [{printable(line.name, 60)}] {printable(line.msg, 300)}"
        for line in layer.lines
    ]
    if lines:
        text += f'<div class="tf"><pre>{escape(chr(10).join(lines[-30:]))}</pre></div>'
    return text
