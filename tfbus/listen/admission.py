"""The first stage of a stream's reception: admits messages by their epochs."""

import math
from collections.abc import Callable

from tfbus.listen.epochs import Verdict
from tfbus.listen.marks import Marks
from tfbus.listen.stream_facts import Listening, Publisher, StreamFacts
from tfbus.wording import stamp_text

# Messages of a disputed epoch ask at most this often for the publisher's word.
_DISPUTES_APART_S = 1.0


class Admission:
    """Admits the messages of one stream whose epoch counts; with the first of a new epoch, what was
    sent before is void.

    `now_s` is a clock that never goes back. Not to be called with the stream's lock held.
    """

    def __init__(
        self, facts: StreamFacts, marks: Marks, around: Listening, now_s: Callable[[], float]
    ) -> None:
        self._facts = facts
        self._marks = marks
        self._around = around
        self._now_s = now_s
        self._has_warned_of_two = False
        self._disputed_s = -math.inf

    def admit(
        self,
        epoch_ns: int,
        *,
        live: bool = False,
        receive: Callable[[bytes], None] | None = None,
        payload: bytes = b"",
    ) -> bool:
        """Whether a message of this epoch counts; `live` if it was sent just now.

        A message of an epoch that has to be confirmed does not count yet: its `payload` goes to
        `receive` once it is.
        """
        facts, epochs = self._facts, self._facts.epochs
        with facts.lock:
            was_gone = epochs.was_gone
            if live:
                of_present = facts.counts.messages - facts.static_set.of_others
                verdict = epochs.judge_live(epoch_ns, of_present, self._now_s())
            else:
                verdict = epochs.judge(epoch_ns)
            is_back = was_gone and not epochs.was_gone
            if verdict is Verdict.PRESENT:
                if is_back:
                    self._marks.invalidate()
            elif verdict is Verdict.OUTDATED:
                facts.counts.outdated += 1
            elif not verdict.counts:
                facts.counts.disputed += 1
            else:
                self._begin_epoch(verdict)
        if verdict is Verdict.PRESENT:
            if is_back:
                self._marks.update()
            return True
        if verdict is Verdict.OUTDATED and epochs.second_publisher_is_alive:
            self._warn_of_two()
        if verdict is Verdict.FUTURE:
            self._warn_future(epoch_ns)
        if verdict is Verdict.DISPUTED:
            if receive is not None:
                self._around.pending.add(facts.name, epoch_ns, receive, payload)
                if epoch_ns == epochs.present_ns:
                    # Confirmed in between, perhaps before the message was added.
                    self._around.pending.release(facts.name, epoch_ns)
                    return False
            self._dispute(epoch_ns)
        if verdict in (Verdict.RESTART, Verdict.TAKEOVER):
            self._restart(epoch_ns, verdict)
        return verdict.counts

    def admit_unconfirmed(self, epoch_ns: int) -> bool:
        """Whether a description of this epoch counts, though it is not confirmed."""
        with self._facts.lock:
            if self._facts.epochs.is_outdated(epoch_ns):
                return False
        return self.admit(epoch_ns)

    def confirm(self, epoch_ns: int, publisher: Publisher | None) -> bool:
        """Take the publisher's word for its epoch; False if it has said a later one since."""
        facts = self._facts
        with facts.lock:
            confirmed_ns = facts.epochs.confirmed_ns
            is_same = publisher is not None and publisher == facts.listing.publisher
            if is_same and confirmed_ns is not None and epoch_ns < confirmed_ns:
                return False
            verdict = facts.epochs.confirm(epoch_ns)
            if verdict is Verdict.RESTART:
                self._begin_epoch(verdict)
        if verdict is Verdict.RESTART:
            self._restart(epoch_ns, verdict)
        return True

    def _begin_epoch(self, verdict: Verdict) -> None:
        """An epoch begins; with the lock held."""
        facts = self._facts
        if verdict is Verdict.FIRST:
            self._marks.invalidate()
        else:
            self._marks.begin_epoch()
            facts.revoke_permit()
        facts.counts.forget_delays()
        present_ns, last_ns = facts.epochs.present_ns or 0, facts.static_set.epoch_ns or 0
        if verdict is Verdict.TAKEOVER or present_ns < last_ns:
            # The set is of another process, or made up: that of an earlier epoch counts now.
            facts.static_set.accept_any()

    def _restart(self, epoch_ns: int, verdict: Verdict) -> None:
        """Drop what was sent before the epoch that has begun."""
        facts, is_takeover = self._facts, verdict is Verdict.TAKEOVER
        if is_takeover:
            self._warn_of_two()
        facts.buffer.forget(facts.name)
        with facts.lock:
            self._marks.end_former()
        self._around.lines.info(
            ("restarted", facts.name, is_takeover),
            "Stream %r restarted: %s; its samples so far are dropped, static transforms stay",
            facts.name,
            "one of the two processes that publish it is silent, so the other counts"
            if is_takeover
            else "its publisher was started again, or its clock went back",
        )
        self._marks.update()
        if is_takeover:
            self._around.on_takeover(facts.name, epoch_ns)

    def _dispute(self, epoch_ns: int) -> None:
        now_s = self._now_s()
        if now_s >= self._disputed_s + _DISPUTES_APART_S:
            self._disputed_s = now_s
            self._around.on_dispute(self._facts.name, epoch_ns)

    def _warn_future(self, epoch_ns: int) -> None:
        self._facts.warn_once(
            "future",
            "Dropped a message of stream %r: its epoch %s is in the future. The clock of its "
            "publisher is wrong, or another process sends on its key",
            self._facts.name,
            stamp_text(epoch_ns),
        )

    def _warn_of_two(self) -> None:
        if not self._has_warned_of_two:
            self._has_warned_of_two = True
            publisher = self._facts.listing.publisher
            self._facts.log.warning(
                "Two processes publish stream %r: %s was started twice, and the messages of one "
                "are dropped. Stop one, or give each its own name (--name)",
                self._facts.name,
                "its node" if publisher is None else publisher[0],
            )
