"""The tools on a buffer and its streams, as the fuzzer left them: all of their output, without a
screen."""

import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from tfbus import Buffer
from tfbus.buffer import formats
from tfbus.bus.graph import graph_of
from tfbus.bus.settings import NodeSettings
from tfbus.cli.monitor import as_lines
from tfbus.cli.output import first_lines, printable_text
from tfbus.frames import document
from tfbus.frames.command_listener import Listening
from tfbus.frames.document import edge_lines, tree_lines
from tfbus.frames.meter import TransformMeter
from tfbus.frames.moment import BusMoment
from tfbus.frames.report import PairWatch, as_map, make_report
from tfbus.frames.snapshot import frame_tree
from tfbus.streams.info import StreamInfo
from tfbus.top.rows import chosen, frames_table, nodes_table, streams_table, topics_table
from tfbus.view.frames import frames_of
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import stream_key

# Those that the others hold by themselves, at any time.
_NOW_NS = 1_700_000_000 * 10**9


class Tools:
    """`tfbus frames`, `monitor`, `top` and the model of `view`, on one buffer."""

    def __init__(self, buffer: Buffer, streams: Callable[[], list[StreamInfo]]) -> None:
        self._buffer = buffer
        self._streams = streams
        node = SimpleNamespace(
            session=SimpleNamespace(
                subscriber=lambda key, callback: None, settings=NodeSettings("fuzz")
            ),
            now_ns=lambda: _NOW_NS,
            log=logging.getLogger("fuzz"),
        )
        listener = SimpleNamespace(streams=streams, dropped=3)
        self._meter = TransformMeter(cast(Any, node))
        self._heard = Listening(cast(Any, node), buffer, cast(Any, listener), None)

    def receive(self, key: str, payload: bytes) -> None:
        """Measure a message, as `monitor` and `top` do."""
        self._meter.receive(key, payload)

    def look(self, described: StreamDescription | None) -> None:
        """Make all that the tools show; none of it raises, and pages have a limit."""
        tree = frame_tree(self._buffer, self._streams(), _NOW_NS)
        for write in (document.as_json, document.as_tf2_dot, document.as_mermaid):
            write(tree)
        document.as_text(tree)
        formats.as_yaml(self._buffer.all_frames())
        formats.as_svg(self._buffer.all_frames())
        for line in (*tree_lines(tree), *edge_lines(tree), *document.summary(tree)):
            printable_text(line)
        report = make_report(self._heard, self._meter, PairWatch("sane_root", "sane_tool"))
        assert report.pair is not None and not report.pair.failure
        as_map(report)
        assert len(first_lines(as_lines(report))) <= 501
        graph = graph_of([], {} if described is None else {stream_key("fuzz"): described})
        tables = (
            frames_table(report),
            streams_table(report),
            nodes_table([]),
            topics_table(graph.topics, graph.services),
        )
        for table in tables:
            assert len({row.key for row in table.rows}) == len(table.rows)
            for column in range(len(table.headings)):
                chosen(table, "", column, True)
        shown = frames_of(BusMoment(at_ns=_NOW_NS, tree=tree), self._buffer, "sane_root")
        assert "sane_tool" in shown
