"""The laws that hold in all histories, looked at while a history runs.

They are laws of listeners whose network has been calm for a while: their process and that of the
publisher run, and the paths between are up, quick and without loss.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import tfbus
from tests.simulation.budgets import beyond
from tests.simulation.model import Publisher
from tests.simulation.plans import PLAIN
from tests.streams.received import registry_of, watch_of
from tfbus.buffer import trajectories
from tfbus.testing.processes import Host, Process

if TYPE_CHECKING:
    from tests.simulation.histories import Part, Run

# A publisher that is gone counts as gone after this time: the lease and what notices its end.
GONE_WITHIN_S = 4.0
# A listener that itself was stopped judges others this long after it goes on.
JUDGES_AFTER_PAUSE_S = 5.0
# One that is there counts as there after this time of calm, and all that it holds is known.
LIVES_WITHIN_S = 10.0
# Messages of one that has gone may come late: it is gone this long after the last of them.
SILENT_FOR_S = 8.0
# A question ends within its time and this.
ENDS_WITHIN_S = 1.0
# A process has at most so many threads.
MOST_THREADS = 32

# After a process with a later epoch whose end no token tells, since another is there, that one
# counts after four messages by itself, and a question.
_ALONE_FOR_PERIODS = 5.0
# It counts at the earliest after such a silence of the other.
_SILENT_BEFORE_TAKEOVER_S = 1.05

_CALM_DELAY_S = 0.1
# A listener believes what those say of their start that it meets in its first 5 s.
_MET_WITHIN_S = 2.0
_MOST_SKEW_NS = 55 * 10**9


@dataclass
class _Question:
    process: Process
    what: str
    due_s: float
    begun_s: float


class Laws:
    """All laws of one run."""

    def __init__(self, run: "Run") -> None:
        self._run = run
        # Since when a listening and a publishing process are calm, and when each one began to run.
        self._calm_s: dict[tuple[Process, Process], float] = {}
        self._running_s: dict[Process, float] = {}
        self.died_s: dict[int, float] = {}
        self._questions: dict[int, _Question] = {}
        self._next_question = 0
        self._heard: dict[tuple[int, str], tuple[int, float]] = {}
        # What is wrong at one look may be under way; at two it is not.
        self._suspected: set[str] = set()
        self._suspects: set[str] = set()
        # The last process that each frame of each listener was of, the stamp of the last that came
        # of it, and when that was seen.
        self._last_seen: dict[tuple[int, str], tuple[int, int | None, float]] = {}
        self._stepped_s: dict[str, float] = {}
        self._stuck: dict[Any, tuple[int, float]] = {}
        # Since when a listener takes a stream for gone.
        self._gone_s: dict[tuple[int, str], float] = {}

    @property
    def _patience(self) -> float:
        """By how much all takes longer where tasks get no processor for a while: most where one
        thread of a listener takes a hundred steps for each of many streams that are back at once.
        """
        plan = self._run.plan
        return 1.0 + plan.stalls * (200.0 + 2.0 * len(plan.publishers))

    # What the laws need to know

    def note_calm(self) -> None:
        """Note which processes run and which paths are calm now."""
        run, now_s = self._run, self._run.now_s
        for publisher in run.by_number.values():
            if publisher.is_gone:
                self.died_s.setdefault(publisher.number, now_s)
        living = [each for each in run.by_number.values() if each.is_alive]
        for process in {*run.readers.values(), *(each.process for each in living)}:
            if process is not None:
                self._note(self._running_s, process, process.is_running)
        readers = {part.process for part in run.parts if not part.process.is_dead}
        are_calm = {
            (one, other): self._is_path_calm(one, other) and self._is_path_calm(other, one)
            for one in {reader.host for reader in readers}
            for other in {each.process.host for each in living if each.process is not None}
        }
        for reader in readers:
            for publisher in living:
                process = publisher.process
                assert process is not None
                is_calm = (
                    reader.is_running
                    and process.is_running
                    and are_calm[reader.host, process.host]
                    and _are_lanes_calm(reader, process)
                )
                self._note(self._calm_s, (reader, process), is_calm)

    def _note(self, since_s: dict[Any, float], what: Any, holds: bool) -> None:
        if holds:
            since_s.setdefault(what, self._run.now_s)
        else:
            since_s.pop(what, None)

    def _is_path_calm(self, one: Host, other: Host) -> bool:
        path = self._run.network._paths.between(one, other)
        is_quick = path.delay_s <= _CALM_DELAY_S and not path.bytes_a_second
        return path.is_up and is_quick and not path.loss

    def note_clock(self, host: str) -> None:
        """The clock of a host was set."""
        self._stepped_s[host] = self._run.now_s

    def calm_for_s(self, process: Process, publisher: Publisher) -> float:
        """For how long all between a listening process and a publisher is calm; -1 if it is not."""
        assert publisher.process is not None
        since_s = self._calm_s.get((process, publisher.process))
        return -1.0 if since_s is None else self._run.now_s - since_s

    def expect_end(self, process: Process, what: str, patience_s: float) -> Callable[[], None]:
        """A question begins, and ends when what this returns is called."""
        now_s = self._run.now_s
        number = self._next_question = self._next_question + 1
        self._questions[number] = _Question(process, what, now_s + patience_s, now_s)
        return lambda: self._questions.pop(number, None) and None

    def tasks_of(self, process: Process) -> list[str]:
        """The tasks of a process besides its main one and the threads of Zenoh."""
        tasks = self._run.network.tasks
        return [
            f"{task.name} (waits for {task.waits_for})"
            for task in tasks.all
            if task.place is process
            and task is not tasks.current
            and task is not process.main
            and not task.name.startswith("zenoh ")
        ]

    # The laws

    def check(self) -> None:
        """Look at all of them now."""
        self.note_calm()
        self._suspects = set()
        self._check_questions()
        self._check_tasks()
        for part in self._run.parts:
            if not (part.process.is_dead or part.process.is_stopped or part.is_closed):
                with self._run.network.within(part.process):
                    self._check_part(part)
        for text in sorted(self._suspects & self._suspected):
            self._run.violate(text)
        self._suspected = self._suspects

    def _suspect(self, text: str) -> None:
        self._suspects.add(text)

    def _check_questions(self) -> None:
        now_s = self._run.now_s
        for question in list(self._questions.values()):
            process = question.process
            since_s = self._running_s.get(process)
            if process.is_dead or process.is_stopped or since_s is None:
                continue
            due_s = max(question.due_s, since_s) + ENDS_WITHIN_S * self._patience
            if now_s > due_s:
                self._run.violate(
                    f"{process.name}: {question.what} was asked at {question.begun_s:.3f}, was to "
                    f"end at {question.due_s:.3f}, and has not ended"
                )

    def _check_tasks(self) -> None:
        """No process has too many threads, and none of them waits long for a lock."""
        now_s, tasks = self._run.now_s, self._run.network.tasks
        counts: dict[Any, int] = {}
        stuck = {}
        for task in tasks.all:
            place: Any = task.place
            if place.is_dead:
                continue
            counts[place] = counts.get(place, 0) + 1
            # A bell is a lock that its own thread waits for.
            is_bell = repr(task.name) in task.waits_for
            if task.waits_for.startswith("a lock") and not (is_bell or place.is_stopped):
                number, since_s = self._stuck.get(task, (-1, 0.0))
                since_s = since_s if number == task.wait_number else now_s
                stuck[task] = task.wait_number, since_s
                if now_s - since_s > 10.0:
                    self._run.violate(f"{place.name}: {task.name} waits for {task.waits_for}")
        self._stuck = stuck
        for place, count in counts.items():
            if count > MOST_THREADS:
                self._run.violate(f"{place.name} has {count} threads")

    def _check_part(self, part: "Part") -> None:
        # As its `streams()` says, without the work of telling all.
        states = watch_of(part.listener).streams()
        if strange := states.keys() - self._run.plan.publishers.keys():
            self._run.violate(f"{part.name}: there are no streams {strange}")
        self._check_budgets(part, states)
        if mistake := part.told.mistake():
            self._suspect(f"{part.name}: {mistake}")
        # An error for an unknown frame names near ones, which takes long.
        frames = set(part.buffer.frames())
        for slot in self._run.plan.publishers:
            if f"{slot}_moving" in frames:
                self._check_samples(part, f"{slot}_moving")
                self._check_lookups(part, f"{slot}_moving")
            living = self._run.living(slot)
            knows_all = len(living) == 1 and self._knows_all_of(part, living[0])
            is_read = slot in part.slots
            # By interest only what streams describe is read.
            is_described = slot != PLAIN or "reads" not in part.options
            if knows_all and is_read and is_described and self._heard_all_of(part, living[0]):
                self._check_moving(part, living[0])
            if slot != PLAIN:
                self._check_alive(part, slot, states.get(slot))
                if knows_all and is_read:
                    self._check_statics(part, living[0])
        self._check_shared(part)

    def _check_budgets(self, part: "Part", states: dict[str, Any]) -> None:
        """What a listener keeps stays within its bounds, and of streams that are gone ends."""
        now_s, gone_for_s = self._run.now_s, {}
        for slot, state in states.items():
            # One whose token is back is asked for until it describes itself.
            is_gone = not (state.alive or watch_of(part.listener).has_token(state.key))
            self._note(self._gone_s, (id(part), slot), is_gone)
            gone_for_s[slot] = now_s - self._gone_s.get((id(part), slot), now_s)
        if extra := registry_of(part.listener).streams().keys() - self._run.plan.publishers.keys():
            self._suspect(f"{part.name}: it keeps streams {sorted(extra)}")
        for text in beyond(part, gone_for_s):
            self._suspect(f"{part.name}: {text}")

    def _knows_all_of(self, part: "Part", publisher: Publisher) -> bool:
        """Whether a listener had the time to know all that the one process of a slot holds."""
        now_s, wait_s = self._run.now_s, LIVES_WITHIN_S * self._patience
        others = [each for each in self._run.publishers[publisher.slot] if each is not publisher]
        alone_s = max((self.died_s.get(each.number, now_s) for each in others), default=-1e9)
        follows = any(self._follows_unseen(publisher, each) for each in others)
        turn_s = _ALONE_FOR_PERIODS * self._run.plan.period_s + wait_s / 2 if follows else 0.0
        assert publisher.process is not None
        # Of a stream that is never described, an epoch more than 60 s ahead of the listener's clock
        # is refused where one that is not counts.
        ahead_ns = publisher.plain_epoch_ns - part.process.host.time_ns()
        is_believed = publisher.slot != PLAIN or not others or ahead_ns < _MOST_SKEW_NS
        return (
            is_believed
            and now_s - part.began_s > wait_s
            and self.calm_for_s(part.process, publisher) > wait_s
            and now_s - alone_s > max(wait_s, turn_s)
            and now_s - publisher.changed_s > wait_s / 2
        )

    def _follows_unseen(self, publisher: Publisher, former: Publisher) -> bool:
        """Whether it was there before the end of another was known, whose epoch may be later."""
        died_s = self.died_s.get(former.number, self._run.now_s)
        if former.node is None or died_s + GONE_WITHIN_S * self._patience < publisher.began_s:
            return False
        return former.epoch > 0 or former.node.started_ns > publisher.node.started_ns

    def _heard_all_of(self, part: "Part", publisher: Publisher) -> bool:
        """Whether it has sent all that it sends since a listener knows it."""
        calm_s = min(self.calm_for_s(part.process, publisher), self._run.now_s - part.began_s)
        return calm_s > LIVES_WITHIN_S * self._patience + 2.5 * self._run.plan.period_s

    def _check_alive(self, part: "Part", slot: str, state: Any) -> None:
        """Nothing gone is taken for living, nothing living for gone."""
        now_s, living = self._run.now_s, self._run.living(slot)
        is_alive = state is not None and state.alive
        for publisher in living:
            known_s = min(self.calm_for_s(part.process, publisher), now_s - part.began_s)
            if not is_alive and known_s > LIVES_WITHIN_S * self._patience:
                self._suspect(f"{part.name}: {slot} is taken for gone and lives")
        key = id(part), slot
        reception = registry_of(part.listener).reception(slot)
        counts = None if reception is None else reception.counts
        count = 0 if counts is None else counts.messages + counts.outdated + counts.disputed
        if self._heard.get(key, (-1, 0.0))[0] != count:
            self._heard[key] = count, now_s
        if living or not is_alive or slot not in self._run.publishers:
            return
        died_s = max(self.died_s.get(each.number, now_s) for each in self._run.publishers[slot])
        gone_for_s = now_s - max(died_s, self._judges_s(part))
        silent_for_s = now_s - self._heard[key][1]
        if (
            gone_for_s > GONE_WITHIN_S * self._patience
            and silent_for_s > SILENT_FOR_S * self._patience
        ):
            self._suspect(f"{part.name}: {slot} is taken for living and is gone")

    def _check_samples(self, part: "Part", frame: str) -> None:
        """All samples of a frame are of one process, in one epoch."""
        sent, found = self._run.sent, _samples(part.buffer, frame)
        if found is None:
            return
        # The one before the first may be older, for what lies between the two.
        span_s = (found.stamps_ns[-1] - found.stamps_ns[:2][-1]) / 1e9
        if span_s > self._run.plan.size.cache_s:
            self._suspect(f"{part.name}: {frame} has samples over {span_s:.1f} s")
        series = {x: sent.of(x) for x in set(found.xyz[:, 0].tolist())}
        for x, each in series.items():
            if each is None or each.frame != frame:
                self._run.violate(f"{part.name}: {frame} has a sample with x {x}")
                return
        whose = sorted({each.whose for each in series.values() if each is not None})
        if len(whose) > 1:
            self._suspect(f"{part.name}: {frame} has samples of several epochs, {whose}")
        self._check_order(part, frame, whose[0][0])

    def _check_order(self, part: "Part", frame: str, number: int) -> None:
        """A process that has ended does not take the place of its successor again.

        Its own word for its epoch may come late, where tasks stall and paths are slow: it counts
        until the successor has given its own. A plain stream gives no word: what comes late of it
        counts again as soon as its successor is silent, which may have ended, too.
        """
        key, newest_ns = (id(part), frame), part.buffer.frame(frame).newest_ns
        last, last_ns, came_s = self._last_seen.get(key, (0, None, 0.0))
        if number >= last and (number, newest_ns) != (last, last_ns):
            self._last_seen[key] = number, newest_ns, self._run.now_s
        later = self._run.by_number.get(last)
        ended_s = self.died_s.get(number, 1e9)
        if later is None or number >= last or ended_s > later.began_s:
            return
        text = f"{part.name}: {frame} is of {number} again, which has ended, after {last}"
        if later.slot == PLAIN:
            # The last of the successor came since the look before, the first of the other till now.
            silent_for_s = self._run.now_s - came_s + self._run.plan.size.look_s
            if silent_for_s < _SILENT_BEFORE_TAKEOVER_S and not self._run.plan.stalls:
                self._run.violate(text)
        elif not self._run.plan.stalls:
            self._run.violate(text)
        elif later.is_alive and self.calm_for_s(part.process, later) > 2.0 * self._patience:
            self._suspect(text)

    def _check_lookups(self, part: "Part", frame: str) -> None:
        """No lookup answers with a value that no process sent for that stamp."""
        for stamp_ns in self._stamps(part.buffer, frame):
            try:
                found = part.buffer.lookup_transform("world", frame, stamp_ns)
            except tfbus.TransformException:
                continue
            x, y = found.transform.x, found.transform.y
            series = self._run.sent.of(x)
            if series is None and self._is_between_lives(part.buffer, frame):
                continue
            if mistake := self._run.sent.mistake(frame, found.stamp_ns, x, y):
                self._suspect(f"{part.name}: {mistake}")

    def _stamps(self, buffer: Any, frame: str) -> list[int | None]:
        """The latest, and a few anywhere between the samples."""
        try:
            info = buffer.frame(frame)
        except tfbus.TransformException:
            return []
        if info.oldest_ns is None or info.newest_ns is None:
            return [None]
        draw = self._run.network.tasks.random
        span_ns = info.newest_ns - info.oldest_ns
        return [None, *(info.oldest_ns + int(span_ns * draw.random()) for _ in range(3))]

    def _is_between_lives(self, buffer: Any, frame: str) -> bool:
        """Whether the samples are of one process that removed the frame and sent it again."""
        found = _samples(buffer, frame)
        if found is None:
            return False
        series = [self._run.sent.of(x) for x in set(found.xyz[:, 0].tolist())]
        return len({each.whose for each in series if each is not None}) == 1 and len(series) > 1

    def _check_statics(self, part: "Part", publisher: Publisher) -> None:
        """A listener has exactly the static transforms that living publishers hold."""
        for number in range(3):
            frame = f"{publisher.slot}_fixed{number}"
            version = publisher.statics.get(frame)
            value = _value(part.buffer, frame)
            wanted = None if version is None else (publisher.number, version)
            # What an earlier process held stays, marked as gone, until it is sent again.
            is_left = (
                value is not None and value[0] != publisher.number and part.buffer.frame(frame).gone
            )
            if value != wanted and not (wanted is None and is_left):
                self._suspect(f"{part.name}: static {frame} is {value}, its publisher has {wanted}")
            elif wanted is not None and part.buffer.frame(frame).gone:
                self._suspect(f"{part.name}: static {frame} is marked as gone, and is there")

    def _check_moving(self, part: "Part", publisher: Publisher) -> None:
        """A listener has what a living publisher sends, and nothing that it has removed."""
        frame = publisher.moving
        value = _value(part.buffer, frame)
        series = None if value is None else self._run.sent.of(value[0])
        is_gone = value is not None and part.buffer.frame(frame).gone
        if frame in publisher.removed:
            if value is not None and not (series and series.publisher is not publisher and is_gone):
                self._suspect(f"{part.name}: {frame} is there, and was removed")
            return
        if frame not in publisher.newest_ns:
            # Removed once, and not sent again so far.
            return
        if series is None or series.publisher is not publisher or is_gone:
            state = f" (value {value}, marked as gone: {is_gone})"
            self._suspect(f"{part.name}: {frame} of {publisher.number} is not there{state}")
            return
        late_ns = publisher.newest_ns.get(frame, 0) - (part.buffer.frame(frame).newest_ns or 0)
        if late_ns > (2.5 * self._run.plan.period_s + 2.0 * self._patience) * 1e9:
            self._suspect(f"{part.name}: {frame} of {publisher.number} is late")

    def _check_shared(self, part: "Part") -> None:
        """With two publishers of a frame the rule decides, everywhere alike."""
        rivals = [each for slot in ("p0", "p1") for each in self._run.living(slot)]
        slots = {each.slot for each in rivals}
        if not rivals or len(slots) != len(rivals):
            return
        for each in rivals:
            if not (self._knows_all_of(part, each) and self._heard_all_of(part, each)):
                return
        former = [each for slot in ("p0", "p1") for each in self._run.publishers.get(slot, ())]
        died_s = max((self.died_s.get(each.number, -1e9) for each in former), default=-1e9)
        if self._run.now_s - died_s < LIVES_WITHIN_S * self._patience:
            return
        value = _value(part.buffer, "shared")
        series = None if value is None else self._run.sent.of(value[0])
        if series is None or series.publisher not in rivals:
            whose = None if series is None else series.publisher.number
            living = [each.number for each in rivals]
            self._suspect(f"{part.name}: shared is of {whose} ({value}), living are {living}")
            return
        winner = self._winner(part, rivals)
        if winner is not None and series.publisher is not winner:
            self._suspect(
                f"{part.name}: shared is of {series.publisher.number}, and {winner.number} wins by "
                f"the rule {self._run.plan.rule}"
            )

    def _winner(self, part: "Part", rivals: list[Publisher]) -> Publisher | None:
        """Whose transforms of the shared frame count, None where that is not known."""
        if len(rivals) == 1:
            return rivals[0]
        if self._run.plan.rule == "priority":
            return rivals[1]
        if self._stepped_s or self._run.plan.size.seconds > 25.0:
            # By the clocks of hosts: what they say of a start is believed within bounds.
            return None
        for each in rivals:
            calm_since_s = self._run.now_s - self.calm_for_s(part.process, each)
            if calm_since_s > max(part.began_s, each.began_s) + _MET_WITHIN_S:
                # Met late, it counts as started then, by the same bounds.
                return None
        return min(rivals, key=lambda each: each.node.started_ns)

    def _judges_s(self, part: "Part") -> float:
        """From when on a listener knows others: after a pause of its own it reads the messages of
        that time, and gives others time.
        """
        running_s = self._running_s.get(part.process, self._run.now_s)
        return running_s + (JUDGES_AFTER_PAUSE_S if running_s > part.began_s else 0.0)

    def check_change(self, part: "Part", change: Any) -> None:
        """A frame is back only where a process is there that has sent it, or was a moment ago: as
        long as its end may still be under way.
        """
        if change.kind != "publisher back":
            return
        slot = change.frame.partition("_")[0]
        now_s, within_s = self._run.now_s, GONE_WITHIN_S * self._patience
        judges_s = self._judges_s(part)
        paused_s = judges_s if judges_s > part.began_s else -math.inf
        for publisher in self._run.publishers.get(slot, ()):
            died_s = max(self.died_s.get(publisher.number, now_s), paused_s)
            if change.frame in publisher.ever_sent and now_s - died_s < within_s:
                return
        if slot in self._run.publishers:
            self._run.violate(f"{part.name}: {change.frame} is back, and no process has sent it")


def _are_lanes_calm(one: Process, other: Process) -> bool:
    """Whether both read what comes, and little is still under way of what was sent before: all
    else waits behind it.
    """
    for session in one.sessions:
        for far in other.sessions:
            face = session.faces.get(far)
            for each in () if face is None else (face, face.far):
                if each.is_deaf or each.lane.busy_s() >= _CALM_DELAY_S:
                    return False
    return True


def _value(buffer: Any, frame: str) -> tuple[float, float] | None:
    if frame not in buffer.frames():
        return None
    try:
        found = buffer.lookup_transform("world", frame)
    except tfbus.TransformException:
        return None
    return found.transform.x, found.transform.y


def _samples(buffer: Any, frame: str) -> Any:
    try:
        found = trajectories.samples(buffer, frame)
    except tfbus.TransformException:
        return None
    return found if len(found) else None
