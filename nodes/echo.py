"""`tfbus echo`: print the pose of a frame repeatedly, as tf2_echo does.

Try it: tfbus echo world turtle1
"""

import itertools
import math
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

import click

from tfbus import (
    Fleet,
    FrameName,
    NodeSettings,
    Number,
    Sampling,
    TransformStamped,
    fleet_options,
    node_options,
)
from tfbus.command import (
    POSITIVE,
    BagChoice,
    Moment,
    MomentType,
    bag_options,
    max_gap_option,
    own_name,
)
from tfbus.frames import (
    CSV_HEADER,
    Numbers,
    csv_line,
    foxy_block,
    json_line,
    recorded_transform,
    recorded_transforms,
    short_line,
    tf2_block,
)

from .echo_answers import Question, answers

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
@click.option("--count", type=click.IntRange(min=1), help="Print this many blocks and exit.")
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
