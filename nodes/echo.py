"""`tfbus echo`: print the pose of a frame repeatedly, as tf2_echo does.

Try it: tfbus echo world turtle1
"""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import click

from tfbus import (
    Buffer,
    ExtrapolationException,
    Fleet,
    FrameName,
    GapException,
    InvalidArgumentException,
    LookupException,
    NodeSettings,
    Number,
    PastExtrapolationException,
    Sampling,
    SystemClock,
    TimeoutException,
    TransformException,
    TransformStamped,
    fleet_options,
    node_options,
)
from tfbus.base.wording import listed
from tfbus.command.options import max_gap_option
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import POSITIVE, Moment, MomentType, own_name
from tfbus.frames.document import (
    CSV_HEADER,
    Numbers,
    csv_line,
    foxy_block,
    json_line,
    short_line,
    tf2_block,
)
from tfbus.frames.recorded_poses import recorded_transform, recorded_transforms

if TYPE_CHECKING:
    from tfbus import Node, TransformListener


# How often a missing transform is logged.
_SAY_EVERY_S = 1.0

_NUMBERS = re.compile(r"-?\d+\.\d+")

# How often to look under a simulated clock, which may stand still; in real time.
_LOOK_EVERY_S = 0.05

# At the start publishers are asked for their history; it comes within this time.
_HISTORY_WITHIN_S = 2.0
_HISTORY_LOOK_S = 0.05
_HISTORY_COMES_S = 0.5
_KEPT_AT_MOST_S = 3600.0
_MARGIN_S = 5.0

# After this long without a newer transform, that is logged.
_STALLED_S = 5.0


@dataclass(frozen=True)
class Question:
    """The pose of `source` seen from `target` at the moment; at the latest time if that is None.

    With a fixed frame: where the source was at the moment, seen from where the target is now.
    """

    target: str
    source: str
    moment: Moment | None = None
    fixed_frame: str | None = None

    def __str__(self) -> str:
        return f"{self.target} -> {self.source}"

    @property
    def has_one_answer(self) -> bool:
        """Whether every answer is the same."""
        return self.moment is not None and not self.moment.is_relative and not self.fixed_frame

    def history_s(self, now_ns: int) -> float:
        """How many seconds of history the answer needs, with a margin.

        0 for the present, and for a date too long ago to be kept.
        """
        if self.moment is None:
            return 0.0
        back_s = (now_ns - self.moment.at(now_ns)) / 1e9
        is_kept = self.moment.is_relative or back_s < _KEPT_AT_MOST_S
        return back_s + _MARGIN_S if is_kept and back_s > 0.0 else 0.0

    def ask(self, buffer: Buffer, now_ns: int, timeout_s: float) -> TransformStamped:
        """The answer, within `timeout_s`. Raises TransformException if there is none."""
        stamp_ns = self.moment.at(now_ns) if self.moment else None
        if self.fixed_frame is None:
            return buffer.lookup_transform(self.target, self.source, stamp_ns, timeout_s=timeout_s)
        return buffer.lookup_transform_full(
            self.target, None, self.source, stamp_ns, self.fixed_frame, timeout_s=timeout_s
        )

    def is_hopeless(self, reason: TransformException) -> bool:
        """Whether waiting cannot help: the moment is before all samples, or in a gap of them."""
        is_absolute = self.moment is not None and not self.moment.is_relative
        return is_absolute and (_is_past(reason) or isinstance(reason, GapException))


def answers(
    node: Node, listener: TransformListener, question: Question, *, rate_hz: float, timeout_s: float
) -> Iterator[TransformStamped]:
    """The answer once a period, until the node is shut down. Seconds are by the node's clock.

    Raises TransformException if there is none for `timeout_s`, or can be none.
    """
    _wait_for_clock(node, timeout_s)
    has_history = question.history_s(node.now_ns()) > 0.0
    history_by_s = time.monotonic() + (_HISTORY_WITHIN_S if has_history else 0.0)
    due_s = _elapsed_s(node)
    gone: frozenset[str] = frozenset()
    progress = _Progress(node)
    if question.fixed_frame and has_history:
        # History comes oldest first: until it is complete, its latest is not the present.
        _wait_for_answer(node, listener, question, timeout_s, history_by_s)
        if node.ok:
            node.wait(_HISTORY_COMES_S, clock=SystemClock())
    while True:
        answer = _wait_for_answer(node, listener, question, timeout_s, history_by_s)
        if answer is None:
            return
        gone = _log_gone(node, listener.buffer, question, gone)
        if question.moment is None and not gone:
            progress.look(answer)
        yield answer
        now_s = _elapsed_s(node)
        due_s = max(due_s + 1.0 / rate_hz, now_s)
        node.wait(due_s - now_s)


def _wait_for_clock(node: Node, timeout_s: float) -> None:
    limit_s = None if math.isinf(timeout_s) else timeout_s
    if not node.wait_for_clock(limit_s) and node.ok:
        raise TimeoutException(f"no message on 'clock' within {timeout_s:g} s: is a clock running?")


class _Progress:
    """Logs once that nothing newer comes."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._newest_ns = 0
        self._since_s = 0.0
        self._is_logged = False

    def look(self, answer: TransformStamped) -> None:
        """Take the next answer; one of static edges alone, with the stamp 0, is never old."""
        if answer.stamp_ns != self._newest_ns:
            self._newest_ns, self._since_s = answer.stamp_ns, _elapsed_s(self._node)
            self._is_logged = False
        elif answer.stamp_ns and not self._is_logged:
            since_s = _elapsed_s(self._node) - self._since_s
            if since_s >= _STALLED_S:
                self._is_logged = True
                self._node.log.warning("Nothing newer for %.1f s; showing the last pose", since_s)


def _log_gone(
    node: Node, buffer: Buffer, question: Question, logged: frozenset[str]
) -> frozenset[str]:
    """The frames on the path whose publisher is gone; logs the ones not in `logged`."""
    try:
        path = buffer.path(question.target, question.source)
        gone = frozenset(frame for frame in path if buffer.frame(frame).gone)
    except TransformException:
        return logged  # a frame has just been removed
    if new := gone - logged:
        node.log.warning(
            "%s: publisher gone; showing its last pose",
            ", ".join(map(repr, sorted(new))),
        )
    return gone


def _wait_for_answer(
    node: Node,
    listener: TransformListener,
    question: Question,
    timeout_s: float,
    history_by_s: float,
) -> TransformStamped | None:
    """The answer as soon as there is one; None if the node is shut down before."""
    give_up_s = _elapsed_s(node) + timeout_s
    # Log lines are for people, so by real time.
    say_at_s, said_s = time.monotonic() + min(_SAY_EVERY_S, timeout_s), _elapsed_s(node)
    said = ""
    while node.ok:
        look_at_s = min(_elapsed_s(node) + _SAY_EVERY_S, give_up_s)
        try:
            wait_s = 0.0 if node.clock.is_simulated else _seconds_until(look_at_s, node)
            return question.ask(listener.buffer, node.now_ns(), wait_s)
        except InvalidArgumentException:
            raise  # waiting cannot help
        except TransformException as error:
            reason = _reason(error)
        if time.monotonic() < history_by_s:
            node.wait(_HISTORY_LOOK_S, clock=SystemClock())
        elif question.is_hopeless(reason):
            if isinstance(reason, GapException):
                raise reason
            moment = question.moment
            if moment and moment.is_from_beginning and not node.clock.is_simulated:
                ago = f"{moment.ns / 1e9:g}s"
                raise PastExtrapolationException(
                    f"--at {ago} is {ago} after the beginning of 1970: -{ago} is {ago} ago"
                )
            raise PastExtrapolationException(
                f"{reason}; echo has only what is sent while it runs, and the history that "
                "publishers keep, 10 s by default"
            )
        elif node.clock.is_simulated:
            # It may stand still for ever; a missing transform is logged all the same.
            node.wait(_LOOK_EVERY_S, clock=SystemClock())
        else:
            node.wait(min(_seconds_until(look_at_s, node), _gap_s(reason)))
        if _elapsed_s(node) >= give_up_s:
            raise TimeoutException(
                f"no transform {question} within {timeout_s:g} s: {_explained(reason, listener)}"
            )
        if time.monotonic() >= say_at_s:
            stands = "" if _elapsed_s(node) > said_s else " (the clock stands still)"
            why = f"{stands}: {_explained(reason, listener)}"
            kind = _NUMBERS.sub("", why)
            if kind != said:  # the reason does not change each second, though its numbers do
                node.log.info("Waiting for transform %s%s", question, why)
            said = kind
            say_at_s, said_s = time.monotonic() + _SAY_EVERY_S, _elapsed_s(node)
    return None


def _elapsed_s(node: Node) -> float:
    return node.clock.elapsed_ns() / 1e9


def _seconds_until(elapsed_s: float, node: Node) -> float:
    return max(0.0, elapsed_s - _elapsed_s(node))


def _is_past(reason: TransformException) -> bool:
    """Whether the requested time is before all samples."""
    return (
        isinstance(reason, ExtrapolationException)
        and reason.requested_ns is not None
        and reason.oldest_ns is not None
        and reason.requested_ns < reason.oldest_ns
    )


def _gap_s(reason: TransformException) -> float:
    """How long until a moment relative to now reaches the first sample."""
    if not isinstance(reason, ExtrapolationException) or not _is_past(reason):
        return math.inf
    if reason.oldest_ns is None or reason.requested_ns is None:
        return math.inf
    return (reason.oldest_ns - reason.requested_ns) / 1e9


def _reason(error: TransformException) -> TransformException:
    """The missing part, without the timeout around it."""
    return (error.reason or error) if isinstance(error, TimeoutException) else error


def _explained(reason: TransformException, listener: TransformListener) -> str:
    """Why there is no answer, and where to look."""
    frames = sorted(listener.buffer.frames())
    hint = listener.where_to_look(reason.frame) if isinstance(reason, LookupException) else ""
    if hint or not frames:
        return f"{reason}: {hint or 'is a broadcaster running?'}"
    known = listed(frames, most=20)
    if str(reason).endswith(known):
        return str(reason)
    end = "" if str(reason).endswith("?") else "."
    return f"{reason}{end} Frames known: {known}"


_STYLES = {"tf2": tf2_block, "foxy": foxy_block, "line": short_line}
_LINES = {"json": json_line, "csv": csv_line}

# Blocks of a recording that are written together.
_AT_A_TIME = 200


class _Echo(click.Command):
    """Names the option for a rate given as a third argument, as to older versions of tf2_echo."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if len(args) > 2 and args[2].replace(".", "", 1).isdigit() and not args[0].startswith("-"):
            raise click.UsageError(f"the rate is an option: --rate {args[2]}", ctx)
        return super().parse_args(ctx, args)


@click.command(
    cls=_Echo,
    epilog="Examples: tfbus echo world turtle1 --rate 10; "
    "tfbus echo world turtle1 --bag run.mcap --format csv",
)
@click.argument("target", type=FrameName())
@click.argument("source", type=FrameName())
@click.option(
    "-r",
    "--rate",
    type=Number(least=1e-6),
    help="Blocks per second (default 1; with --bag one for each sample).",
)
@click.option(
    "-p",
    "--precision",
    metavar="N",
    type=click.IntRange(0, 17),
    default=3,
    show_default=True,
    help="Decimal places, in text.",
)
@click.option(
    "--style",
    type=click.Choice(list(_STYLES)),
    default="tf2",
    show_default=True,
    help="Text as in the newest tf2_echo, as in Foxy's, or in one line.",
)
@click.option("--raw-zeros", is_flag=True, help="Keep the sign of zero: -0.000.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", *_LINES]),
    default="text",
    show_default=True,
    help="Blocks of text; or one JSON object or CSV row per line, with all digits.",
)
@click.option("--once", is_flag=True, help="Print one block and exit.")
@click.option(
    "--changed", is_flag=True, help="Print a transform only if it differs from the last printed."
)
@click.option(
    "--count", metavar="N", type=click.IntRange(min=1), help="Print this many blocks and exit."
)
@click.option(
    "-t",
    "--at",
    "moment",
    metavar="TIME",
    type=MomentType(),
    help="The time to look up: seconds or ns since 1970, ISO 8601, or -3s from now. With --bag: "
    "3 is 3 s after its beginning, -3 is 3 s before its end.",
)
@click.option(
    "--fixed-frame",
    metavar="FRAME",
    type=FrameName(),
    help="Show where SOURCE was at --at, seen from TARGET now; FRAME must not have moved since.",
)
@click.option(
    "--timeout",
    type=POSITIVE,
    metavar="SECONDS",
    help="Exit with 1 after this long without a transform.",
)
@bag_options("begin", "end", statics=True)
@max_gap_option
@fleet_options
@node_options(lambda: own_name("echo"))
def main(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    target: str,
    source: str,
    rate: float | None,
    precision: int,
    style: str,
    raw_zeros: bool,
    form: str,
    once: bool,
    changed: bool,
    count: int | None,
    moment: Moment | None,
    fixed_frame: str | None,
    timeout: float | None,
    sampling: Sampling,
) -> None:
    """Print the pose of the frame SOURCE seen from the frame TARGET.

    The order is that of tf2_echo, whose help swaps the two names. With --bag: the poses at all
    samples of a recording, or of a span of it, or with --at the one at a moment.
    """
    if once and count is not None:
        raise click.UsageError("--once and --count are mutually exclusive: give one")
    question = Question(target, source, moment, fixed_frame)
    limit = 1 if once or (count is None and question.has_one_answer) else count
    write = partial(_LINES.get(form, _STYLES[style]), numbers=Numbers(precision, raw_zeros))
    if bag is not None:
        if timeout is not None:
            raise click.UsageError("--timeout waits for a bus: omit it with --bag")
        found = _recorded(replace(bag, at=moment), settings, fleet, question, rate, sampling)
        _print_recorded(map(write, _limited(found, changed, limit)), form)
        return
    from tfbus import Buffer, Node, TransformListener  # Zenoh, which a recording does not need

    rate = 1.0 if rate is None else rate
    timeout_s = math.inf if timeout is None else timeout
    is_complete = limit is None  # it goes on until Ctrl-C
    with suppress(KeyboardInterrupt), Node(settings=settings, patience_s=timeout_s) as node:
        history_s = question.history_s(node.now_ns())
        buffer = Buffer(max(10.0, history_s), sampling=sampling)
        with TransformListener(buffer, node, history_s=history_s, fleet=fleet) as listener:
            node.ready(f"Printing {question} at {rate:g} Hz")
            found = answers(node, listener, question, rate_hz=rate, timeout_s=timeout_s)
            blocks = _limited(found, changed, limit)
            header = CSV_HEADER if form == "csv" else ""
            is_complete = _print_all(map(write, blocks), header, limit)
    if not is_complete:
        raise SystemExit(128 + signal.SIGINT)


def _recorded(
    bag: BagChoice,
    settings: NodeSettings,
    fleet: Fleet | None,
    question: Question,
    rate: float | None,
    sampling: Sampling,
) -> Iterator[TransformStamped]:
    """The answers of a recording."""
    names = question.target, question.source
    if bag.at is not None and (bag.begin is not None or bag.end is not None):
        raise click.UsageError("--at is one moment: omit --from and --to")
    if bag.at is not None or question.fixed_frame is not None:
        return iter(
            [recorded_transform(bag, settings, fleet, *names, question.fixed_frame, sampling)]
        )
    return recorded_transforms(bag, settings, fleet, *names, rate, sampling)


def _limited(
    found: Iterator[TransformStamped], changed: bool, limit: int | None
) -> Iterator[TransformStamped]:
    return itertools.islice(_changes(found) if changed else found, limit)


def _print_recorded(blocks: Iterator[str], form: str) -> None:
    """Print all, many at a time; end quietly when the reader of stdout is gone."""
    header = CSV_HEADER if form == "csv" else ""
    try:
        while some := list(itertools.islice(blocks, _AT_A_TIME)):
            click.echo("\n".join([header, *some] if header else some))
            header = ""
    except BrokenPipeError:
        # Python flushes stdout again at exit, which would fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _changes(found: Iterator[TransformStamped]) -> Iterator[TransformStamped]:
    """The transforms that differ from the one before."""
    last = None
    for answer in found:
        if last is None or not answer.transform.is_close(last.transform):
            last = answer
            yield answer


def _print_all(blocks: Iterator[str], header: str, limit: int | None) -> bool:
    """Print each block at once; end quietly when the reader of stdout is gone.

    Returns whether that was all: as many blocks as the limit, or any number if it is None.
    """
    printed = 0
    try:
        for block in blocks:
            click.echo(f"{header}\n{block}" if header else block)
            header = ""
            printed += 1
    except BrokenPipeError:
        # Python flushes stdout again at exit, which would fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return limit is None or printed == limit


if __name__ == "__main__":
    main()
