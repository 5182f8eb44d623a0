"""`tfbus doctor`: what is wrong with this bus, the evidence, and what to do."""

import textwrap
from collections import Counter
from dataclasses import asdict

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import json_option, paint, print_json, print_lines, warn, width
from tfbus.command.options import listening_options
from tfbus.command.types import Number, own_name
from tfbus.doctor.checks import CHECKS
from tfbus.doctor.examine import examine
from tfbus.doctor.finding import Finding, Verdict
from tfbus.wire.fleet import Fleet

_ROLES: dict[Verdict, str] = {"ok": "good", "warn": "warning", "fail": "bad", "skipped": "faint"}
_NAME_WIDTH = 2 + max(map(len, CHECKS))
_INDENT = " " * 4


@click.command(epilog="Examples: tfbus doctor; tfbus doctor --only clock-skew --json")
@click.option(
    "--only",
    "names",
    type=click.Choice(list(CHECKS)),
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
@listening_options(own_name("_doctor"))
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    names: tuple[str, ...],
    listen_s: float,
    list_checks: bool,
    as_json: bool,
) -> None:
    """Check this host and the bus, and say what to fix; exits with 1 on a failure."""
    if list_checks:
        print_lines(f"{name.ljust(_NAME_WIDTH)}{check.__doc__}" for name, check in CHECKS.items())
        return
    seen = examine(settings, listen_s, warn, fleet)
    findings = {name: CHECKS[name](seen) for name in CHECKS if not names or name in names}
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
