"""Why a lookup has no answer: the error for it, with the facts, and the remedy."""

import math
from collections.abc import Collection, Iterable
from typing import SupportsFloat, TypeVar

from tfbus.base.callbacks import here
from tfbus.base.errors import (
    ConnectivityException,
    ExtrapolationException,
    FutureExtrapolationException,
    GapException,
    InvalidArgumentException,
    LookupException,
    NoDataException,
    PastExtrapolationException,
    SingleSampleException,
    StaleException,
    TimeoutException,
    TransformException,
)
from tfbus.base.stamps import Mistake, other_clock, other_unit, unit_hint
from tfbus.base.structs import Struct
from tfbus.base.wording import duration, stamp_text
from tfbus.buffer.tree import Question, Tree
from tfbus.geometry.kernel import ALL_STATIC, NO_DATA, History
from tfbus.geometry.sampling import Sampling

_Kind = TypeVar("_Kind", bound=ExtrapolationException)

# The advice of errors; tools that have options for it name their options instead.
LATER, LATEST = "query a later time", "query the latest"

# Of the frames of a loop an error names the first, and the first again.
_MOST_CHAINED = 6


class Freshness(Struct):
    """The conditions of a lookup on every edge on its path.

    `max_age_s` is how old its newest sample may be, by the buffer's clock (None: any age); a
    static edge has no age. With `living` its publisher must not be gone, a static one's neither.
    """

    max_age_s: float | None = None
    living: bool = False

    def __post_init__(self) -> None:
        if self.max_age_s is not None:
            check_seconds(self.max_age_s, "max_age_s")

    def why_stale(
        self, tree: Tree, pairs: Iterable[tuple[str, str]], now_ns: int
    ) -> StaleException | None:
        """The error if an edge between a pair of frames is stale; None if none is.

        A publisher that is gone comes before an old sample: it is why the sample is old.
        """
        paths = [tree.path(target_frame, source_frame) for target_frame, source_frame in pairs]
        edges = [edge for path in paths if path is not None for edge in path.edges()]
        gone = next((edge for edge in edges if edge.gone), None)
        if self.living and gone is not None:
            age_s = _age_s(gone, now_ns)
            return _stale(gone, age_s, "its publisher is gone", advice="start it again")
        if self.max_age_s is None:
            return None
        aged = [(age_s, edge) for edge in edges if (age_s := _age_s(edge, now_ns)) is not None]
        age_s, oldest = max(aged, key=lambda pair: pair[0], default=(0.0, None))
        if oldest is None or age_s <= self.max_age_s:
            return None
        allowed = f"max_age_s allows {self.max_age_s:g} s"
        if oldest.gone:
            why = f"{allowed}, and its publisher is gone"
            return _stale(oldest, age_s, why, advice="start it again")
        if clock := other_clock(now_ns, now_ns - round(age_s * 1e9)):
            return _stale(oldest, age_s, f"{allowed}; {clock.fact}", advice=clock.advice)
        return _stale(
            oldest,
            age_s,
            allowed,
            advice="allow more",
            waiting="wait for the next",
            waiting_by="timeout_s",
        )


def check_seconds(
    seconds: object, what: str, *, least: float = 0.0, most: float = math.inf
) -> None:
    """Raise InvalidArgumentException, which calls it `what`, unless it is a number of seconds in
    these bounds.
    """
    if isinstance(seconds, SupportsFloat) and not isinstance(seconds, bool):
        if least <= float(seconds) <= most:
            return
        shown = f"{seconds!r:.60}"
    else:
        shown = f"a {type(seconds).__name__}"
    bounds = f"{max(least, 0.0):g} or more" if most == math.inf else f"{least:g} to {most:g}"
    raise InvalidArgumentException(f"{what} must be a number of seconds, {bounds}, not {shown}")


def may_come(error: TransformException) -> bool:
    """Whether waiting may help: frames, edges and newer samples may arrive, older samples not."""
    if isinstance(error, PastExtrapolationException | InvalidArgumentException | TimeoutException):
        return False
    if isinstance(error, SingleSampleException):
        return (error.requested_ns or 0) > (error.newest_ns or 0)
    if isinstance(error, GapException):
        return error.requested_ns is None
    return True


def advice_after(error: TransformException) -> str:
    """The advice after a wait that ended with this error: in a callback that holds up the sender
    that it waits for, how not to; "" if the error's own advice holds.
    """
    held_up = here.held_up(getattr(error, "authority", ""))
    if not held_up:
        return ""
    return (
        f"this node sends it itself, and its {held_up} waits for this callback to return: await "
        "buffer.wait_for_transform(...) in an async def, or give this callback a callback_group"
    )


def without_waiting(error: TransformException) -> TransformException:
    """The error, for a buffer that gets no further data: it does not advise to wait, nor to start a
    publisher that was gone.
    """
    error.waiting = ""
    if isinstance(error, ExtrapolationException):
        error.retry_after_s = None
    if isinstance(error, StaleException) and error.gone:
        error.advice = ""
    return error


def without_timeout(error: TransformException, *, many: bool = False) -> TransformException:
    """The error, for a call that has no `timeout_s`: it advises to ask again later; with `many`
    stamps also to leave out unknown stamps, if its own advice is to ask for the latest.
    """
    if isinstance(error, ExtrapolationException) and error.retry_after_s is not None:
        error.waiting, error.waiting_by = f"ask again in about {error.retry_after_s:.3g} s", ""
        if many:
            error.advice = "only for stamps that are known"
            error.advice_by = "lookup_known_transforms"
    return error


def unknown_frame(frame: str, known: Collection[str]) -> LookupException:
    """The error for an unknown frame, with the known names that look like it."""
    return LookupException(f"there is no frame {frame!r}", frame=frame, known=known)


def why_not(
    tree: Tree, names: Iterable[str], question: Question, sampling: Sampling
) -> TransformException:
    """The error of a lookup that did not answer this question; `names` are all frames that it
    names, of which none may be unknown. It names edges of the path only.
    """
    # All names first, as tf2 does: a time is of no use to a frame that is unknown.
    for frame in names:
        if frame not in tree.frames:
            return unknown_frame(frame, list(tree.frames))
    target_frame, source_frame, stamp_ns = question
    error = _between(tree, target_frame, source_frame, stamp_ns, sampling)
    return error or ExtrapolationException(
        f"{source_frame!r} could not be seen from {target_frame!r} a moment ago, but can be now",
        advice="query it again",
        requested_ns=stamp_ns,
    )


def _between(
    tree: Tree, target_frame: str, source_frame: str, stamp_ns: int | None, sampling: Sampling
) -> TransformException | None:
    """The error for two known frames; None if they can be joined now."""
    path = tree.path(target_frame, source_frame)
    if path is None:
        return _not_connected(tree, target_frame, source_frame)
    edges = path.edges()
    asked_ns = stamp_ns
    if stamp_ns is None and path.is_mixed() and path.latest() not in (ALL_STATIC, NO_DATA):
        stamp_ns = path.latest()
    if stamp_ns is not None and path.is_mixed():
        # The path was another then: only the edges where it broke off count.
        ends = [tree.walk_end(frame, stamp_ns, sampling) for frame in (source_frame, target_frame)]
        edges = [end for end in ends if end.parent is not None]
    missing: TransformException | None = None
    for history in edges:
        if missing is not None and _is_to_come(history, stamp_ns, sampling):
            continue
        error = _no_data(history, stamp_ns, sampling) or _gap(history, stamp_ns, asked_ns, sampling)
        # An error that waiting cannot help says more than an error that it may.
        if error is not None and not may_come(error):
            return error
        missing = missing or error
    if missing is not None:
        return missing
    if stamp_ns is not None and path.is_mixed():
        why, advice = "a frame between them had another parent then", ""
        loops = [tree.loop_above(end, stamp_ns, sampling) for end in (source_frame, target_frame)]
        if loop := loops[0] or loops[1]:
            why = (
                f"{_chained([loop[0], *reversed(loop)])} was a loop then, as each keeps its parent "
                "until its next sample"
            )
            advice = "query an earlier or a later time"
        return ConnectivityException(
            f"{target_frame!r} and {source_frame!r} were not connected at {stamp_text(stamp_ns)} "
            f"s: {why}",
            advice=advice,
            target_frame=target_frame,
            source_frame=source_frame,
        )
    if stamp_ns is not None:
        return None
    gaps = (_gap(history, path.latest(), None, sampling) for history in edges)
    return _out_of_step(edges) or next((error for error in gaps if error is not None), None)


def _is_to_come(history: History, stamp_ns: int | None, sampling: Sampling) -> bool:
    """Whether waiting helps for sure, if this edge has no data for a time."""
    if sampling.max_gap_s is not None:
        return False
    span = None if history.static else history.stamp_span()
    return stamp_ns is None or span is None or stamp_ns > span[1]


def _chained(frames: list[str]) -> str:
    """The edges from the first frame to the last, parent before child."""
    names = [repr(frame) for frame in frames]
    if len(names) > _MOST_CHAINED:
        names[_MOST_CHAINED - 1 : -1] = ["..."]
    return " -> ".join(names)


def _out_of_step(edges: list[History]) -> ExtrapolationException | None:
    """For the latest time: an edge whose samples end before another edge's begin."""
    spans = [(history, history.stamp_span()) for history in edges if not history.static]
    known = [(span, history) for history, span in spans if span is not None]
    if not known:
        return None
    (_, newest), late = min(known, key=lambda each: each[0][1])
    (oldest, _), ahead = max(known, key=lambda each: each[0][0])
    if oldest <= newest:
        return None
    unit = _confused_units(oldest, newest)
    if unit:
        return _error(ExtrapolationException, late, None, unit)
    if other_clock(oldest, newest):
        return _error(
            ExtrapolationException,
            late,
            None,
            f"its stamps and those of {ahead.name!r} are of different clocks",
            advice="if one of the two is simulated, pass --sim-time to the publishers of both",
        )
    return _error(
        ExtrapolationException,
        late,
        None,
        f"its newest sample is {_far(newest - oldest)} than the oldest of {ahead.name!r}, so they "
        "have no common time",
        advice="keep more",
        advice_by="cache_time_s",
        waiting="wait for newer ones",
    )


def _not_connected(tree: Tree, target_frame: str, source_frame: str) -> ConnectivityException:
    roots = [tree.chain(tree.frames[frame])[-1].name for frame in (target_frame, source_frame)]
    return ConnectivityException(
        f"{target_frame!r} and {source_frame!r} are not connected: their roots are {roots[0]!r} "
        f"and {roots[1]!r}",
        advice="a transform between the two trees is missing",
        target_frame=target_frame,
        source_frame=source_frame,
        target_root=roots[0],
        source_root=roots[1],
    )


def _no_data(
    history: History, stamp_ns: int | None, sampling: Sampling
) -> ExtrapolationException | None:
    if history.static:
        return None
    span = history.stamp_span()
    if span is None:
        return _error(
            NoDataException, history, stamp_ns, "it has no sample", waiting="wait for one"
        )
    if stamp_ns is None:
        return None
    oldest, newest = span
    beyond = max(oldest - stamp_ns, stamp_ns - newest)
    if sampling.interpolation == "nearest":
        beyond -= round(sampling.tolerance_s * 1e9)
    elif history.count() > 1:
        beyond -= round(sampling.extrapolation_s * 1e9)
    if beyond <= 0:
        if reason := history.interruption(stamp_ns):
            return _error(ExtrapolationException, history, stamp_ns, reason)
        return _too_far(history, stamp_ns) if sampling.interpolation == "nearest" else None
    kind: type[ExtrapolationException] = FutureExtrapolationException
    if history.count() == 1:
        kind = SingleSampleException
    elif stamp_ns < oldest:
        kind = PastExtrapolationException
    if mistake := mistake_of(stamp_ns, newest):
        return _error(kind, history, stamp_ns, mistake.fact, advice=mistake.advice)
    if kind is SingleSampleException:
        away = f"its only sample is {_far(newest - stamp_ns)}"
        if stamp_ns > newest:
            return _error(kind, history, stamp_ns, away, waiting="wait for another")
        return _error(kind, history, stamp_ns, away, advice=LATER)
    if kind is PastExtrapolationException:
        away = f"its oldest sample is {_far(oldest - stamp_ns)}"
        return _error(kind, history, stamp_ns, away, advice=LATER)
    wait_s = _retry_after_s(history.count(), oldest, newest, stamp_ns)
    return _error(
        kind,
        history,
        stamp_ns,
        f"its newest sample is {_far(newest - stamp_ns)}",
        advice=LATEST,
        advice_by="stamp_ns=None",
        waiting=f"wait about {wait_s:.3g} s",
        waiting_by="timeout_s",
        retry_after_s=wait_s,
    )


def mistake_of(stamp_ns: int, newest: int) -> Mistake | None:
    """The mistake if a stamp is of another unit, or another clock, than the newest sample's."""
    unit = _confused_units(stamp_ns, newest)
    mistake = Mistake(unit, "") if unit else other_clock(stamp_ns, newest)
    if mistake is not None and stamp_ns == 0:
        fact = "the stamp 0 is the year 1970, not the latest as in tf2"
        return Mistake(fact, "omit it for the latest")
    return mistake


def _gap(
    history: History, stamp_ns: int | None, asked_ns: int | None, sampling: Sampling
) -> GapException | None:
    """For a time between two samples, or beyond two of them, that are too far apart; `asked_ns` is
    None if it is the latest.
    """
    if stamp_ns is None or sampling.max_gap_s is None:
        return None
    around = history.around(stamp_ns)
    if around is None or around[1] - around[0] <= round(sampling.max_gap_s * 1e9):
        return None
    is_latest = asked_ns is None
    error = _error(
        GapException,
        history,
        asked_ns,
        f"its samples at {stamp_text(around[0])} and {stamp_text(around[1])} s are "
        f"{duration((around[1] - around[0]) / 1e9)} apart, and max_gap_s allows "
        f"{sampling.max_gap_s:g} s",
        advice="allow more" if is_latest else "query another time, or allow more",
        waiting="wait for newer ones" if is_latest else "",
    )
    error.before_ns, error.after_ns = around
    error.max_gap_s = sampling.max_gap_s
    return error


def _confused_units(stamp_ns: int, newest: int) -> str:
    """The advice if either of the requested stamp and the newest sample's is in seconds, or
    another unit; "" if both are nanoseconds.
    """
    if unit := other_unit(stamp_ns, newest):
        return unit_hint(stamp_ns, unit)
    if unit := other_unit(newest, stamp_ns):
        return f"its publisher's stamps seem wrong: {unit_hint(newest, unit)}"
    return ""


def _too_far(history: History, stamp_ns: int) -> ExtrapolationException | None:
    """For `nearest`: no sample within the tolerance, between two that are farther away."""
    return _error(
        ExtrapolationException,
        history,
        stamp_ns,
        "no sample is within the tolerance",
        advice="widen it, or interpolate",
    )


def _error(
    kind: type[_Kind],
    history: History,
    stamp_ns: int | None,
    why: str,
    *,
    retry_after_s: float | None = None,
    **words: str,
) -> _Kind:
    parent = history.parent.name if history.parent is not None else ""
    span = history.stamp_span()
    when = "" if stamp_ns is None else f" at {stamp_text(stamp_ns)} s"
    sent = f", sent by {history.authority!r}{when and ','}" if history.authority else ""
    return kind(
        f"no data for {parent!r} -> {history.name!r}{sent}{when}: {why}",
        frame_id=parent,
        child_frame_id=history.name,
        requested_ns=stamp_ns,
        oldest_ns=None if span is None else span[0],
        newest_ns=None if span is None else span[1],
        authority=history.authority,
        retry_after_s=retry_after_s,
        **words,
    )


def _retry_after_s(count: int, oldest: int, newest: int, stamp_ns: int) -> float:
    """Until the first sample that is not older than the stamp, at the average period."""
    period_ns = (newest - oldest) / (count - 1)
    periods = -((newest - stamp_ns) // period_ns)
    return periods * period_ns / 1e9


def _age_s(edge: History, now_ns: int) -> float | None:
    span = None if edge.static else edge.stamp_span()
    return None if span is None else (now_ns - span[1]) / 1e9


def _stale(edge: History, age_s: float | None, why: str, **words: str) -> StaleException:
    parent = edge.parent.name if edge.parent is not None else ""
    sent = f", sent by {edge.authority!r}," if edge.authority else ""
    what = "static" if age_s is None else f"{age_s:.3f} s old"
    return StaleException(
        f"{parent!r} -> {edge.name!r}{sent} is {what}: {why}",
        frame_id=parent,
        child_frame_id=edge.name,
        authority=edge.authority,
        age_s=age_s,
        gone=edge.gone,
        **words,
    )


def _far(difference_ns: int) -> str:
    side = "later" if difference_ns > 0 else "earlier"
    distance = abs(difference_ns)
    if distance < 1_000_000:
        return f"{distance} ns {side}"
    return (
        f"{distance / 1e6:.3f} ms {side}" if distance < 10**9 else f"{distance / 1e9:.3f} s {side}"
    )
