"""Tokens, descriptions and messages of a stream in any order: the laws of the buffer."""

import logging

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.builders import S, at, examples, payload
from tests.streams.received import appear
from tfbus import Buffer
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.wire.transforms import TransformReader

CHILDREN = st.frozensets(st.sampled_from(["a", "b", "c", "d"]))
EPOCHS = st.integers(1, 4)
STAMPS = st.integers(0, 10**6)


def sent(children: frozenset[str], epoch_ns: int, stamp_ns: int) -> bytes:
    """A message whose poses show its epoch: `epoch_ns` metres ahead."""
    return payload([at(epoch_ns, child, stamp_ns) for child in sorted(children)], epoch_ns)


class Orders(RuleBasedStateMachine):
    """A stream whose messages come in any order, from several processes of one name."""

    @initialize()
    def listen(self) -> None:
        self.buffer = Buffer(cache_time_s=1e6)
        log = logging.getLogger("test_reception_orders")
        log.disabled = True
        self.time_s = 0.0
        self.stream = StreamReception(
            "sim", self.buffer, log, lambda: 0, TransformReader(), now_s=lambda: self.time_s
        )
        self.key = DynamicReception(self.stream)
        self.listed: tuple[int, frozenset[str]] = (0, frozenset())
        self.other = Buffer()

    @rule(children=CHILDREN, epoch=EPOCHS, second=STAMPS)
    def send(self, children: frozenset[str], epoch: int, second: int) -> None:
        before = self.stream.counts.outdated
        self.key.receive(sent(children, epoch, second * S))
        if self.stream.counts.outdated == before:
            assert self.stream.epoch_ns == epoch
            assert all(self.buffer.can_transform("world", child) for child in children)
        else:
            assert epoch != self.stream.epoch_ns

    @rule(children=CHILDREN, epoch=EPOCHS, second=STAMPS)
    def send_alone(self, children: frozenset[str], epoch: int, second: int) -> None:
        """A process that sends alone counts, whatever came before."""
        for _ in range(5):
            self.time_s += 1.0
            self.key.receive(sent(children, epoch, second * S))
        assert self.stream.epoch_ns == epoch

    @rule(children=CHILDREN, epoch=EPOCHS, second=STAMPS)
    def send_kept(self, children: frozenset[str], epoch: int, second: int) -> None:
        self.stream.receive_kept(sent(children, epoch, second * S))

    @rule(children=CHILDREN, epoch=EPOCHS)
    def send_static(self, children: frozenset[str], epoch: int) -> None:
        before = self.stream.counts.outdated
        self.stream.statics.receive(sent(frozenset(c.upper() for c in children), epoch, 0))
        if self.stream.counts.outdated == before:
            for child in children:
                found = self.buffer.lookup_transform("world", child.upper())
                assert found.transform.x == epoch

    @rule(children=CHILDREN, statics=CHILDREN, epoch=EPOCHS)
    def describe(self, children: frozenset[str], statics: frozenset[str], epoch: int) -> None:
        fixed = frozenset(child.upper() for child in statics)
        self.stream.describe(epoch, children | fixed, fixed)
        if self.stream.epoch_ns == epoch:
            self.listed = (epoch, children | fixed)

    @rule()
    def appear(self) -> None:
        appear(self.stream)

    @rule()
    def vanish(self) -> None:
        self.stream.vanish()

    @invariant()
    def all_samples_are_of_one_epoch(self) -> None:
        """No dynamic sample of a former epoch is left."""
        for child, samples in self.buffer.sent_by("sim").items():
            if samples:
                info = self.buffer.frame(child)
                for stamp_ns in (info.oldest_ns, info.newest_ns):
                    found = self.buffer.lookup_transform("world", child, stamp_ns)
                    assert found.transform.x == self.stream.epoch_ns

    @invariant()
    def all_frames_are_gone_with_the_publisher(self) -> None:
        """Where the publisher is gone, so is every frame; else none that it lists is gone."""
        gone = {info.name for info in self.buffer.all_frames() if info.gone}
        held = set(self.buffer.sent_by("sim"))
        epoch, listed = self.listed
        if self.stream.facts.epochs.gone:
            assert gone == held
        elif epoch == self.stream.epoch_ns:
            assert gone.isdisjoint(listed)


TestOrders = Orders.TestCase
TestOrders.settings = settings(max_examples=examples(60), stateful_step_count=25, deadline=None)
