"""`tfbus doctor`: what is wrong with this bus, the evidence, and what to do."""

import textwrap
from collections import Counter
from dataclasses import asdict, replace

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import json_option, paint, print_json, print_lines, warn, width
from tfbus.command.options import listening_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import Number, own_name
from tfbus.doctor.checks import CHECKS
from tfbus.doctor.finding import Finding, Verdict
from tfbus.doctor.recorded_checks import RECORDED_CHECKS
from tfbus.wire.fleet import Fleet

_ROLES: dict[Verdict, str] = {"ok": "good", "warn": "warning", "fail": "bad", "skipped": "faint"}
_ALL = {**CHECKS, **RECORDED_CHECKS}
_NAME_WIDTH = 2 + max(map(len, _ALL))
_INDENT = " " * 4


@click.command(
    epilog="Examples: tfbus doctor; tfbus doctor --only clock-skew --json; "
    "tfbus doctor --bag run.mcap"
)
@click.option(
    "--only",
    "names",
    type=click.Choice(list(_ALL)),
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
@json_option("Print one JSON object: verdict, evidence and remedy of each check.")
@bag_options("begin", "end")
@listening_options(lambda: own_name("_doctor"))
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    names: tuple[str, ...],
    listen_s: float,
    list_checks: bool,
    as_json: bool,
) -> None:
    """Check this host and the bus, and say what to fix; exits with 1 on a failure.

    With --bag, check a recording, or a span of it.
    """
    checks = CHECKS if bag is None else RECORDED_CHECKS
    if list_checks:
        print_lines(f"{name.ljust(_NAME_WIDTH)}{check.__doc__}" for name, check in checks.items())
        return
    for name in names:
        if name not in checks:
            where = "a bus, not of a recording" if bag else "a recording: give --bag FILE"
            raise click.UsageError(f"--only {name} is a check of {where}")
    if bag is not None:
        findings = _check_recording(settings, fleet, bag, names, as_json)
    else:
        from tfbus.doctor.examine import examine  # Zenoh, which a recording does not need

        seen = examine(settings, listen_s, warn, fleet)
        findings = {name: CHECKS[name](seen) for name in CHECKS if not names or name in names}
    _print(findings, as_json)


def _check_recording(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    names: tuple[str, ...],
    as_json: bool,
) -> dict[str, Finding]:
    from tfbus.cli.recorded import span_lines
    from tfbus.doctor.recorded import examine_recorded
    from tfbus.frames.recorded_poses import frames_of

    with bag.opened() as recording:
        from_ns, to_ns = recording.span
        frames = frames_of(recording, settings, fleet)
        is_complete = recording.reader.is_complete
        seen = examine_recorded(frames, settings, from_ns, to_ns, is_complete=is_complete)
        damage = tuple(each.text(frames.start_ns) for each in recording.reader.damage)
        seen = replace(seen, damage=damage)
        if not as_json:
            print_lines(span_lines(bag, frames, from_ns, to_ns))
    return {
        name: check(seen) for name, check in RECORDED_CHECKS.items() if not names or name in names
    }


def _print(findings: dict[str, Finding], as_json: bool) -> None:
    if as_json:
        print_json({name: asdict(finding) for name, finding in findings.items()})
    else:
        for name, finding in findings.items():
            print_lines(_lines(name, finding))
        print_lines([_summary(findings)])
    if any(finding.verdict == "fail" for finding in findings.values()):
        raise SystemExit(1)


def _lines(name: str, finding: Finding) -> list[str]:
    verdict = paint(finding.verdict.ljust(8), _ROLES[finding.verdict])
    head = f"{verdict}{name.ljust(_NAME_WIDTH)}"
    if finding.verdict in ("ok", "skipped"):
        return [f"{head}{paint('; '.join(finding.evidence), 'faint')}".rstrip()]
    lines = [head.rstrip()]
    for sentence in finding.evidence:
        lines += _wrapped(sentence, "- ")
    return [*lines, *_wrapped(f"Fix: {finding.remedy}", "")]


def _wrapped(text: str, bullet: str) -> list[str]:
    return textwrap.wrap(
        text,
        max(width(), 40),
        initial_indent=f"{_INDENT}{bullet}",
        subsequent_indent=_INDENT + " " * len(bullet),
        break_on_hyphens=False,
    )


def _summary(findings: dict[str, Finding]) -> str:
    count = Counter(finding.verdict for finding in findings.values())
    order: tuple[Verdict, ...] = ("ok", "warn", "fail", "skipped")
    return ", ".join(f"{count[verdict]} {verdict}" for verdict in order if count[verdict])
