"""`tfbus doctor`: the problems of this bus, the evidence, and the remedies."""

import re
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import closing, suppress
from dataclasses import asdict, replace

import click

from tfbus.base.wording import (
    and_more,
    counted,
    cut,
    duration,
    listed,
    natural_order,
    near_names,
    wrapped,
)
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import frames_in_span, span_lines
from tfbus.cli.output import (
    json_option,
    paint,
    print_json,
    print_lines,
    run_in_shell,
    warn,
    width,
)
from tfbus.command.options import check_grace, grace_option, listening_options, roster_option
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import Number
from tfbus.doctor.examination import (
    CHECKS,
    OF_A_BUS,
    Examination,
    Finding,
    Verdict,
    examine_recorded,
    examined,
    scope,
)
from tfbus.frames.moment import Ongoing
from tfbus.wire.fleet import Fleet

_ROLES: dict[Verdict, str] = {"ok": "good", "warn": "warning", "fail": "bad", "skipped": "faint"}
_VERDICT_WIDTH = 8
_NAME_WIDTH = 2 + max(map(len, CHECKS))
_INDENT = " " * 4
# A screen has at most so many sentences of a check; of a fleet, where each robot may have the same
# trouble, so many that are not alike.
_MOST_SENTENCES = 10
_OF_FLEET, _ROBOTS_NAMED, _LONGEST_REMEDY = 3, 5, 300
_WORD, _DIGITS = re.compile(r"[\w.-]+"), re.compile(r"[\d.]+")


class _CheckName(click.Choice[str]):
    """The name of a check; an unknown one is answered with the nearest."""

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for another text."""
        if value in CHECKS:
            return str(value)
        near = near_names(str(value), CHECKS)
        meant = f"; did you mean {' or '.join(map(repr, near))}?" if near else ";"
        self.fail(
            f"there is no check {str(value)!r}{meant} tfbus doctor --list names all", param, ctx
        )


@click.command(
    epilog="Examples: tfbus doctor; tfbus doctor --only clock-skew --json; "
    "tfbus doctor --fleet --expect 'robot[1-30]'; tfbus doctor --bag run.mcap"
)
@click.option(
    "--only",
    "names",
    type=_CheckName(list(CHECKS)),
    multiple=True,
    metavar="CHECK",
    help="Run only this check; repeatable. --list names all.",
)
@click.option(
    "--for",
    "listen_s",
    type=Number(least=0.5, most=3600.0),
    default=3.0,
    metavar="SECONDS",
    show_default=True,
    help="How long to listen, at least 0.5.",
)
@click.option("--list", "list_checks", is_flag=True, help="Print the checks and exit.")
@click.option(
    "-w",
    "--watch",
    is_flag=True,
    help="Go on until Ctrl-C, and print each finding when it begins and when it ends.",
)
@click.option("--exit-on-fail", is_flag=True, help="With --watch: exit with 1 at a failure.")
@click.option(
    "--on-fail",
    "on_fail",
    metavar="COMMAND",
    help="With --watch: run this in a shell at each failure that begins, with TFBUS_CHECK, "
    "TFBUS_EVIDENCE and TFBUS_REMEDY in its environment.",
)
@grace_option("--watch takes them for missing")
@json_option("Print one JSON object: verdict, evidence and remedy of each check.")
@bag_options("begin", "end")
@roster_option
@listening_options("_doctor")
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    names: tuple[str, ...],
    listen_s: float,
    list_checks: bool,
    watch: bool,
    exit_on_fail: bool,
    on_fail: str | None,
    grace_s: float,
    as_json: bool,
    roster: tuple[str, ...],
) -> None:
    """Check this host and the bus, and say what to fix; exits with 1 on a failure.

    Nodes and frames are those of the namespace, with --fleet those of all below it too; a robot of
    the roster that is gone or missing is a failure. With --bag, check a recording, or a span of it.
    """
    if list_checks:
        print_lines(
            f"{name.ljust(_NAME_WIDTH)}{check.promise}"
            for name, check in CHECKS.items()
            if check.applies(to_recording=bag is not None)
        )
        return
    if (exit_on_fail or on_fail) and not watch:
        raise click.UsageError("--exit-on-fail and --on-fail are for --watch")
    check_grace(watch and roster, "--watch with --expect")
    if bag is not None:
        if watch:
            raise click.UsageError("--watch checks a bus; a recording does not change")
        _check_recording(settings, fleet, bag, names, as_json, roster)
        return
    from tfbus.doctor.examine import examine  # Zenoh, which a recording does not need

    if watch and not as_json:
        place = scope(settings.namespace, is_fleet=fleet is not None)
        print_lines([_watching(place, _watched(names), listen_s)])
    examinations = examine(settings, listen_s, warn, fleet, roster, grace_s if watch else 0.0)
    with closing(examinations):
        if watch:
            with suppress(KeyboardInterrupt):  # its usual end
                _watch(examinations, _watched(names), as_json, exit_on_fail, on_fail)
        else:
            _print(next(examinations), names, as_json)


def _watched(names: tuple[str, ...]) -> list[str]:
    """The checks that make sense again and again: the doctor itself reads each stream then."""
    return [name for name in names or CHECKS if name != "unread"]


def _watching(place: str, names: list[str], listen_s: float) -> str:
    """The first line of --watch, before anything is known."""
    which = names[0] if len(names) == 1 else counted(len(names), "check")
    return f"{_now()} watching {place}: {which}, first findings after {duration(listen_s)}"


def _watch(
    examinations: Iterable[Examination],
    names: list[str],
    as_json: bool,
    exit_on_fail: bool,
    on_fail: str | None,
) -> None:
    """Print findings when they begin and end, for ever."""
    ongoing: Ongoing[tuple[str, Verdict], Finding] = Ongoing()
    is_first = True
    for seen in examinations:
        found, shortened = examined(seen, names), _Shortened(seen)
        troubles: dict[tuple[str, Verdict], Finding] = {
            (name, each.verdict): each
            for name, each in found.items()
            if each.verdict in ("warn", "fail")
        }
        begun, ended = ongoing.update(troubles)
        for (name, _), finding in ended.items():
            _say(name, finding, as_json, "ended")
        for (name, _), finding in begun.items():
            _say(name, finding if as_json else shortened(finding), as_json, "begun")
        if is_first and not begun and not as_json:
            print_lines([f"{_now()} {_summary(found)}: nothing is wrong"])
        is_first = False
        failed = [(name, each) for (name, verdict), each in begun.items() if verdict == "fail"]
        for name, finding in failed if on_fail else ():
            told = {
                "TFBUS_CHECK": name,
                "TFBUS_EVIDENCE": "\n".join(shortened(finding).evidence),
                "TFBUS_REMEDY": finding.remedy,
            }
            run_in_shell("--on-fail", on_fail or "", told)
        if failed and exit_on_fail:
            raise SystemExit(1)


def _say(name: str, finding: Finding, as_json: bool, event: str) -> None:
    if as_json:
        print_json({"at_ns": time.time_ns(), "event": event, "check": name} | asdict(finding))
    elif event == "ended":
        print_lines([f"{_now()} {paint('ended'.ljust(8), 'good')}{name}"])
    else:
        first, *rest = _lines(name, finding)
        print_lines([f"{_now()} {first}", *rest])


def _now() -> str:
    return time.strftime("%H:%M:%S")


def _check_recording(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    names: tuple[str, ...],
    as_json: bool,
    roster: tuple[str, ...],
) -> None:
    with frames_in_span(bag, settings, fleet) as (frames, from_ns, to_ns):
        seen = examine_recorded(frames, settings, from_ns, to_ns, fleet, roster)
        if not as_json:
            print_lines(span_lines(bag, frames, from_ns, to_ns))
        _print(seen, names, as_json)


def _print(seen: Examination, names: tuple[str, ...], as_json: bool) -> None:
    findings = examined(seen, names)
    if as_json:
        print_json({name: asdict(finding) for name, finding in findings.items()})
    else:
        print_lines([_scope(seen)])
        shortened = _Shortened(seen)
        # Of all checks, the ones that cannot be made of a recording are one line.
        left_out = [name for name, each in findings.items() if each == OF_A_BUS]
        alone = len(left_out) == len(findings)
        for name, finding in findings.items():
            if alone or name not in left_out:
                print_lines(_lines(name, shortened(finding)))
        if left_out and not alone:
            others = ", ".join(left_out)
            print_lines(_wrapped(f"{_summary(findings)} (of a live bus only: {others})", ""))
        else:
            print_lines([_summary(findings)])
    if any(finding.verdict == "fail" for finding in findings.values()):
        raise SystemExit(1)


def _scope(seen: Examination) -> str:
    """The line that says of which namespaces the nodes and frames are."""
    text = f"Nodes and frames of {seen.scope}"
    if seen.below:
        text += f"; {counted(len(seen.below), 'node')} below it: see --fleet"
    return paint(text, "faint")


class _Shortened:
    """Findings for a screen: the first sentences of each; of a fleet, the same problem of many
    robots is one.
    """

    def __init__(self, seen: Examination) -> None:
        self._is_fleet = seen.is_fleet
        names = [each.name for each in seen.robots]
        self._robots = {chunk: robot for robot in names for chunk in robot.split("/")}

    def __call__(self, finding: Finding) -> Finding:
        """Its first sentences, of a fleet each with the robots of which the same is true."""
        if not self._is_fleet:
            evidence = list(finding.evidence[:_MOST_SENTENCES])
            if more := and_more(len(finding.evidence), _MOST_SENTENCES):
                evidence.append(f"{more} (--json has all)")
            return replace(finding, evidence=tuple(evidence))
        alike: dict[str, list[str]] = {}
        for sentence in finding.evidence:
            alike.setdefault(self._pattern(sentence), []).append(sentence)
        evidence = [self._joined(sentences) for sentences in alike.values()][:_OF_FLEET]
        if more := and_more(len(alike), _OF_FLEET):
            evidence.append(f"{more}: see --json, and tfbus fleet")
        remedy = cut(finding.remedy, _LONGEST_REMEDY)
        return replace(finding, evidence=tuple(evidence), remedy=remedy)

    def _joined(self, sentences: list[str]) -> str:
        first = min(sentences, key=natural_order)
        others = {robot for each in sentences for robot in self._named(each)} - self._named(first)
        if not others:
            return first
        names = listed(sorted(others, key=natural_order), most=_ROBOTS_NAMED)
        return f"{first}; the same of {counted(len(others), 'other robot')}: {names}"

    def _pattern(self, sentence: str) -> str:
        """A sentence without the names of robots and numbers."""
        without = _WORD.sub(lambda word: "" if word[0] in self._robots else word[0], sentence)
        return _DIGITS.sub("", without)

    def _named(self, sentence: str) -> set[str]:
        return {self._robots[word] for word in _WORD.findall(sentence) if word in self._robots}


def _lines(name: str, finding: Finding) -> list[str]:
    verdict = paint(finding.verdict.ljust(_VERDICT_WIDTH), _ROLES[finding.verdict])
    head = f"{verdict}{name.ljust(_NAME_WIDTH)}"
    if finding.verdict in ("ok", "skipped"):
        lead = " " * (_VERDICT_WIDTH + _NAME_WIDTH)
        first, *more = _wrapped("; ".join(finding.evidence), lead) or [lead]
        text = paint(first.removeprefix(lead), "faint")
        return [f"{head}{text}".rstrip(), *(paint(each, "faint") for each in more)]
    lines = [head.rstrip()]
    for sentence in finding.evidence:
        lines += _wrapped(sentence, f"{_INDENT}- ")
    return [*lines, *_wrapped(f"Fix: {finding.remedy}", _INDENT)]


def _wrapped(text: str, lead: str) -> list[str]:
    return wrapped(text, max(width(), 40), lead)


def _summary(findings: dict[str, Finding]) -> str:
    count = Counter(finding.verdict for finding in findings.values())
    order: tuple[Verdict, ...] = ("ok", "warn", "fail", "skipped")
    return ", ".join(f"{count[verdict]} {verdict}" for verdict in order if count[verdict])
