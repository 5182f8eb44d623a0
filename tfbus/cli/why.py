"""`tfbus why`: the path of a lookup, edge by edge, why it fails, and the remedies."""

from dataclasses import asdict, replace
from pathlib import Path

import click

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.wording import age, stamp_text, wrapped
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import frames_at, listening, moment_lines, out_of_reach
from tfbus.cli.output import json_option, paint, print_json, print_lines
from tfbus.command.options import listening_options, roster_option
from tfbus.command.recordings import BagChoice, bag_option, statics_option
from tfbus.command.types import FrameName, Moment, MomentType
from tfbus.frames.fleet import FleetWatch
from tfbus.frames.why import (
    ON_THE_BUS,
    Explanation,
    FleetAdvice,
    Step,
    explain,
    explain_recorded,
)
from tfbus.recording.state import Statics
from tfbus.wire.fleet import Fleet

_ROLES = {"ok": "good", "warn": "warning", "fail": "bad"}

# The longest line.
_LONGEST = 80

# The most history that it asks for.
_LONGEST_BACK_S = 3600.0


@click.command(epilog="Examples: tfbus why world turtle1; tfbus why world turtle1 --at -3s")
@click.argument("target", type=FrameName())
@click.argument("source", type=FrameName())
@click.option(
    "-t",
    "--at",
    "moment",
    metavar="TIME",
    type=MomentType(),
    help="Seconds or ns since 1970, ISO 8601, or -3s from now (default: the latest time). With "
    "--bag: 3 is 3 s after its beginning, -3 is 3 s before its end.",
)
@json_option("Print a JSON object.")
@bag_option
@statics_option
@roster_option
@listening_options("_why")
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    moment: Moment | None,
    as_json: bool,
    bags: tuple[Path, ...],
    statics: Statics | None,
    roster: tuple[str, ...],
) -> None:
    """Explain, edge by edge, why SOURCE cannot be seen from TARGET, and what to do.

    It asks publishers for their history, so --at may be in the past. Exits with 1 if the lookup
    fails. With --bag it explains the lookup at that moment of the recording, by default the latest.
    """
    if roster and bags:
        raise click.UsageError("--expect says which robots are missing now; --bag is of the past")
    if bags:
        bag = BagChoice(bags, moment, statics=statics or "always")
        _explain_recorded(settings, fleet, target, source, bag, as_json)
        return
    if statics is not None:
        raise click.UsageError("--statics is for a recording: give --bag")
    # Zenoh: no recording needs it
    from tfbus.bus.presence import ask_nodes, frames_in_other_namespaces

    with listening(
        settings, fleet, history_s=_history_s(moment, settings), cache_time_s=_LONGEST_BACK_S
    ) as heard:
        session, asked_ns = heard.node.session, heard.now_ns()
        # It takes a while, in which samples come: the tree and the lookup are of after it.
        elsewhere = () if fleet else frames_in_other_namespaces(session)
        heard.ask_about_clocks()
        if fleet is not None and not {target, source}.issubset(heard.buffer.frames()):
            heard.ask_nodes()
        moment_now, advice = heard.moment(), ON_THE_BUS
        if fleet is not None:
            robots = FleetWatch(roster).robots(moment_now, has_frames=False)
            advice = FleetAdvice(robots, roster)
        explanation = explain(
            moment_now,
            heard.buffer,
            target,
            source,
            moment.at(asked_ns) if moment else None,
            reads_only=settings.closed.identity.namespace if settings.closed else "",
            frames_in_other_namespaces=elsewhere,
            advice=advice,
        )
        nodes = ask_nodes(session).nodes
        waiting = [
            f"{node.name}: {each}"
            for node in nodes
            for each in node.filters
            if each.frame == target and source in each.sources
        ]
        explanation = replace(explanation, filters=tuple(waiting))
        if not heard.buffer.frames() and (hint := out_of_reach(session)):
            explanation = replace(explanation, remedies=(hint,))
    _print(explanation, as_json)


def _explain_recorded(
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    bag: BagChoice,
    as_json: bool,
) -> None:
    with frames_at(bag, settings, fleet) as heard:
        explanation = explain_recorded(
            heard, target, source, bag.written, at_moment=bag.at is not None
        )
        if not as_json:
            print_lines(moment_lines(bag, heard))
        _print(explanation, as_json)


def _print(explanation: Explanation, as_json: bool) -> None:
    if as_json:
        print_json(_as_map(explanation))
    else:
        print_lines(_lines(explanation))
    if explanation.answer is None:
        raise SystemExit(1)


def _history_s(moment: Moment | None, settings: NodeSettings) -> float:
    """How much history to ask for: back to the moment, and 10 s to measure rates."""
    back_s = 0.0
    if moment is not None:
        now_ns = SYSTEM_CLOCK.now_ns()
        back_s = (now_ns - moment.at(now_ns)) / 1e9
        if settings.sim_time and not moment.is_relative:
            back_s = _LONGEST_BACK_S  # by a clock that is not known yet
    return min(max(back_s, 0.0) + 10.0, _LONGEST_BACK_S)


def _lines(it: Explanation) -> list[str]:
    lines = [paint(f"{it.source} seen from {it.target}{_when(it)}: {_outcome(it)}", "heading")]
    lines += wrapped(it.failure, _LONGEST, "  ") if it.failure else []
    for step in it.steps:
        lines += _step_lines(step)
    if it.filters:
        lines.append(paint("Messages that wait for it:", "heading"))
        lines += [line for each in it.filters for line in wrapped(each, _LONGEST, "  - ")]
    if it.remedies:
        lines.append(paint("What to do:", "heading"))
        lines += [line for remedy in it.remedies for line in wrapped(remedy, _LONGEST, "  - ")]
    return lines


def _when(it: Explanation) -> str:
    return "" if it.stamp_ns is None else f" at {stamp_text(it.stamp_ns)}"


def _outcome(it: Explanation) -> str:
    if it.answer is None:
        return "no answer"
    return "there is an answer" if it.age_s is None else f"there is an answer, {age(it.age_s)}"


def _step_lines(step: Step) -> list[str]:
    verdict = paint(f"{step.verdict:4}", _ROLES[step.verdict])
    text = f"{step.parent} -> {step.child}  {', '.join(step.facts)}"
    lines = wrapped(text, _LONGEST, "        ")
    lines[0] = f"  {verdict}  {lines[0].lstrip()}"
    return lines + (wrapped(step.reason, _LONGEST, "        ") if step.reason else [])


def _as_map(it: Explanation) -> dict[str, object]:
    answer = it.answer and {
        "stamp_ns": it.answer.stamp_ns,
        "xyz": it.answer.transform.xyz.tolist(),
        "quat_xyzw": it.answer.transform.quat_xyzw.tolist(),
    }
    steps = [asdict(step) for step in it.steps]
    lookup = {"target": it.target, "source": it.source, "stamp_ns": it.stamp_ns, "answer": answer}
    said = {"remedies": list(it.remedies), "filters": list(it.filters)}
    return {**lookup, "failure": it.failure, "steps": steps, **said}
