"""The topics that are drawn: which, from which messages, and on a thread of their own, so that
frames do not wait for clouds and images.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import islice, takewhile
from typing import Any

import numpy as np
import viser

from tfbus import messages
from tfbus.base import scheduler
from tfbus.base.log import LogOnce
from tfbus.base.wording import counted, did_you_mean, listed, printable
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph import TopicInfo
from tfbus.geometry.transform import Transform
from tfbus.view.data.layer import TopicLayer
from tfbus.view.data.picked import PickedPoint, picked
from tfbus.view.data.shapes import Points, Text
from tfbus.view.data.topics import (
    MOST_TOPICS,
    POINTS,
    DataSource,
    Waiting,
    camera_topic,
    drawn_type,
)
from tfbus.view.frames import Floats, Frames
from tfbus.view.scene.camera import Ray
from tfbus.view.scene.items import DrawnItems, MeshNamed, NotDrawnError, some_points, way_to
from tfbus.view.settings import TopicSettings, ViewSettings, topic_of

_PERIOD_S = 1.0 / 30.0
# The pause after a drawing is so many times as long: data take two fifths of a core at most.
_RESTS_PER_DRAWING = 1.5
_END_S = 5.0
# A picture waits at most so long for a drawing.
_HOLDS_AFTER_S = 60.0
# Nodes that begin with the view have told their topics by then.
_ABSENT_AFTER_S = 5.0


@dataclass(frozen=True)
class _Sight:
    """The buffer, the fixed frame and the settings to draw by; while `is_held` nothing changes."""

    buffer: Buffer
    fixed_frame: str
    settings: ViewSettings
    is_held: bool


class DataScenes:
    """Draws the topics of a bus that have their box ticked, while a browser is there.

    `topics` can be drawn, `layers` are the drawings of the wanted ones;
    `ever_drawn` topics had something in the scene. Pictures of the panel are set by this thread
    too: `show_picture[topic](picture)`. `mesh_named` is that of DrawnItems.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        source: DataSource,
        log: logging.Logger,
        mesh_named: MeshNamed = lambda name, drawn: "there is no robot",
    ) -> None:
        self._server = server
        self._source = source
        self._log = log
        self._log_once = LogOnce(log)
        self.topics: dict[str, TopicInfo] = {}
        self.layers: dict[str, TopicLayer] = {}
        self.ever_drawn: set[str] = set()
        self.show_picture: dict[str, Callable[[Any], object]] = {}
        self._all: Mapping[str, TopicInfo] = {}
        self._camera_of: dict[str, str] = {}
        self._cameras: dict[str, messages.CameraInfo] = {}
        # Each with the function that showed it.
        self._shown_pictures: dict[str, tuple[Callable[[Any], object], Any]] = {}
        self._items = DrawnItems(server, mesh_named)
        self._sight: _Sight | None = None
        self._is_held = False
        self._drawing = threading.Lock()
        self._since_s = scheduler.monotonic()
        self._has_warned = False
        self._warned: set[str] = set()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    # On the page's thread

    def see(
        self,
        buffer: Buffer,
        fixed_frame: str,
        settings: ViewSettings,
        *,
        is_held: bool,
        is_watched: bool,
    ) -> None:
        """Draw by these settings; ask for topics, and subscribe, only while somebody looks. Topics
        to draw from the start that are not there are named once.
        """
        shown = list(settings.drawn)
        if is_watched or (shown and not self._has_warned):
            self._all = self._source.topics()
            drawn = {name: info for name, info in self._all.items() if drawn_type(info)}
            topics = dict(sorted(drawn.items())[:MOST_TOPICS])
            named = {each.topic: topics.get(topic_of(each.topic)) for each in settings.topics}
            again = [(name, info) for name, info in named.items() if info and name not in topics]
            self.topics = topics | dict(again[:MOST_TOPICS])
        if not self._has_warned and scheduler.monotonic() - self._since_s >= _ABSENT_AFTER_S:
            self._has_warned = True
            self.warn_of([topic for topic in shown if topic not in self.topics])
        shown = shown if is_watched else []
        wanted = {name: self.topics[name] for name in shown if name in self.topics}
        cameras = {
            name: camera_topic(name, self._all)
            for name, info in wanted.items()
            if drawn_type(info) in (messages.Image, messages.CompressedImage)
        }
        self._camera_of = {name: beside for name, beside in cameras.items() if beside}
        beside = {name: self._all[name] for name in self._camera_of.values()}
        self._source.want(wanted | beside)
        self._sight = _Sight(buffer, fixed_frame, settings, is_held)
        if wanted and self._thread is None:
            self._thread = threading.Thread(target=self._run, name="tfbus view data", daemon=True)
            self._thread.start()

    def points(self, most: int | None = None) -> Floats:
        """Some of the points of all that is drawn (N, 3), in the fixed frame; of at most so many
        items of a topic.
        """
        found = [
            placed.pose.apply(some_points(shape))
            for layer in self.layers.copy().values()
            for placed in islice(layer.placed.copy().values(), most)
            for shape in placed.item.shapes
        ]
        return np.concatenate(found) if found else np.zeros((0, 3))

    def texts(self) -> dict[object, tuple[Text, Transform]]:
        """The texts that are shown, each at its pose in the fixed frame."""
        settings = self._sight.settings if self._sight else ViewSettings()
        return {
            (topic, key, at): (shape, placed.pose)
            for topic, layer in self.layers.copy().items()
            for key, placed in layer.placed.copy().items()
            for at, shape in enumerate(placed.item.shapes)
            if isinstance(shape, Text) and _is_shown(key, settings.of_topic(topic))
        }

    def met_by(self, ray: Ray) -> float:
        """The way in m along a ray of the fixed frame to shapes of messages; infinity for none."""
        ways = [
            way_to(ray.seen_from(placed.pose), shape)
            for layer in self.layers.copy().values()
            for placed in layer.placed.copy().values()
            for shape in placed.item.shapes
        ]
        return min(ways, default=math.inf)

    def point_met_by(self, ray: Ray, fixed_frame: str) -> PickedPoint | None:
        """The first point of a cloud or scan in a ray of the fixed frame; None for none."""
        met = [
            (first, topic, layer, points, placed.pose)
            for topic, layer in self.layers.copy().items()
            if layer.waiting.message_type in POINTS
            for placed in layer.placed.copy().values()
            for points in placed.item.shapes
            if isinstance(points, Points)
            if (first := ray.seen_from(placed.pose).first_of(points.xyz)) is not None
        ]
        if not met:
            return None
        (row, _), topic, layer, points, pose = min(met, key=lambda each: each[0][1])
        return picked(topic, points, row, layer.source_of(points), fixed_frame, pose)

    def note(self, fixed_frame: str, frames: Frames) -> str:
        """The messages that wait for a transform to the fixed frame, and the frame to choose for
        them; "" if none does.
        """
        waits = [layer for layer in self.layers.copy().values() if layer.waits_in]
        if not waits:
            return ""
        count = counted(sum(max(layer.waiting_count, 1) for layer in waits), "message")
        lead = f"{count} wait for a transform to {printable(fixed_frame)}"
        own = frames[fixed_frame].root if fixed_frame in frames else ""
        names = {layer.waits_in for layer in waits}
        roots = sorted({frames[name].root for name in names if name in frames} - {own})
        if roots:
            return f"{lead}: choose as the fixed frame {listed([*map(printable, roots)], most=3)}"
        unknown = sorted(names - frames.by_name.keys())
        if unknown:
            return f"{lead}: there is no frame {listed([*map(printable, unknown)], most=3)}"
        return f"{lead}: see the tab Data"

    def subscribers(self, topic: str) -> int:
        """How many subscriptions a topic has on the bus, as it was known last."""
        info = self._all.get(topic)
        return len(info.subscribers or ()) if info else 0

    def close(self) -> None:
        """End the thread. Twice is fine."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(_END_S)
        self._source.close()

    def hold(self) -> None:
        """Leave everything as it is, for a picture, once the drawing in progress has ended:
        drawing a recording's past may take seconds.
        """
        is_drawn = self._drawing.acquire(timeout=_HOLDS_AFTER_S)
        self._is_held = True
        if is_drawn:
            self._drawing.release()

    @property
    def has_pictures_without_camera(self) -> bool:
        """Whether an image is to be seen in the panel only, as no camera is known for the scene."""
        layers = list(self.layers.values())
        return any(each.picture is not None and not each.placed for each in layers)

    def warn_of(self, topics: Iterable[str]) -> None:
        """Log of each of these topics, once, why nothing of it is drawn, if nothing is."""
        for topic in topics:
            if topic not in self._warned and (why := self._why_not_drawn(topic)):
                self._warned.add(topic)
                self._log.warning("Topic %r is not drawn: %s", topic, why)

    def _why_not_drawn(self, topic: str) -> str:
        info = self._all.get(topic) or self._all.get(topic_of(topic))
        if topic not in self.topics and info is not None and info.publishers:
            types = listed(sorted({printable(end.type) for end in info.publishers}), most=3)
            return f"it has {types}, which the view does not draw"
        if topic not in self.topics:
            near = did_you_mean(topic, self.topics, none="; there is none that can be")
            return f"there is no such topic of messages that are drawn{near}"
        layer = self.layers.get(topic)
        if layer is not None and (layer.placed or layer.picture is not None or layer.lines):
            return ""
        return (layer.trouble if layer is not None else "") or "no message has come"

    def rejected(self, topic: str) -> int:
        """How many messages of a topic could not be read."""
        return self._source.rejected(topic)

    # On its own thread

    def _run(self) -> None:
        rest_s = 0.0
        while not self._ended.wait(max(_PERIOD_S, rest_s)):
            begin_s = time.monotonic()
            try:
                with self._drawing:
                    self.step(begin_s)
            except Exception as error:
                if self._ended.is_set():
                    return
                self._log_once.exception((type(error), str(error)), "Could not draw messages")
            rest_s = _RESTS_PER_DRAWING * (time.monotonic() - begin_s)

    def step(self, now_s: float) -> None:
        """Take the messages that came, and draw them."""
        sight = self._sight
        if sight is None or self._is_held:
            return
        pace_s, now_s = now_s, self._source.catch_up(now_s)
        chosen = sight.settings.drawn
        layers: dict[str, TopicLayer] = {}
        for topic in chosen:
            waiting = self._source.waiting(topic)
            if waiting is not None and topic in self.topics:
                layer = self.layers.get(topic)
                if (
                    layer is None
                    or layer.waiting is not waiting
                    or (
                        self._source.is_recorded
                        and not layer.is_by(sight.fixed_frame, chosen[topic])
                    )
                ):
                    layer = self._begun(topic, waiting, sight.fixed_frame, chosen[topic])
                layers[topic] = layer
        # A browser that comes back finds its layers again.
        kept = {name: each for name, each in self.layers.items() if name in chosen}
        self.layers = kept | layers
        for topic, layer in layers.items():
            if sight.is_held:
                break
            camera = self._camera(topic)
            try:
                layer.step(
                    *(sight.buffer, sight.fixed_frame, now_s, chosen[topic], camera), pace_s=pace_s
                )
            except Exception as error:  # the other topics are drawn all the same
                layer.fail(error)
                self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)
        self.ever_drawn |= {topic for topic, layer in layers.items() if layer.placed}
        with self._server.atomic():
            self._draw(chosen)
        for topic, layer in layers.items():
            self._show_picture(topic, layer)
        self._server.flush()
        now_ns = self._source.now_ns()
        for layer in layers.values():
            layer.was_sent(now_ns)

    def _begun(
        self, topic: str, waiting: Waiting, fixed_frame: str, settings: TopicSettings
    ) -> TopicLayer:
        """A layer with the earlier messages."""
        layer = TopicLayer(waiting)
        try:
            past = self._source.past(topic, settings)
            # The page may be closed meanwhile.
            past = takewhile(lambda _: not self._ended.is_set(), past)
            layer.recall(past, fixed_frame, settings, self._camera(topic))
        except Exception as error:  # the other topics are drawn all the same
            layer.fail(error)
            self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)
        return layer

    def _camera(self, topic: str) -> messages.CameraInfo | None:
        beside = self._camera_of.get(topic, "")
        waiting = self._source.waiting(beside) if beside else None
        if waiting is not None and (taken := waiting.take()):
            self._cameras[topic] = taken[-1]
        return self._cameras.get(topic) if beside else None

    def _show_picture(self, topic: str, layer: TopicLayer) -> None:
        show, picture = self.show_picture.get(topic), layer.picture
        if show is None or picture is None:
            return
        by, shown = self._shown_pictures.get(topic, (None, None))
        if by != show or shown is not picture:
            self._shown_pictures[topic] = show, picture
            show(picture)

    def _draw(self, chosen: Mapping[str, TopicSettings]) -> None:
        items = {
            (topic, key): placed
            for topic, layer in self.layers.items()
            for key, placed in layer.placed.items()
        }
        for gone in self._items.places() - items.keys():
            self._items.remove(gone)
        for at, placed in items.items():
            topic, key = at
            try:
                settings = chosen[topic]
                is_shown = _is_shown(key, settings)
                self._items.draw(at, placed, settings.size, is_shown=is_shown)
            except NotDrawnError as error:
                self._items.remove(at)
                self.layers[topic].fail(error, key)
            except Exception as error:  # the others are drawn all the same
                self._items.remove(at)
                self.layers[topic].fail(error, key)
                self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)


def _is_shown(key: object, settings: TopicSettings) -> bool:
    """Whether the item of this key is not of a hidden namespace."""
    return not (isinstance(key, tuple) and key[0] in settings.hidden)
