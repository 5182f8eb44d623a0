"""The result of a check."""

from dataclasses import dataclass
from typing import Literal

from tfbus.wording import and_more

_MOST_SENTENCES = 10

Verdict = Literal["ok", "warn", "fail", "skipped"]


@dataclass(frozen=True)
class Finding:
    """The verdict of one check, its evidence, and what to do about it.

    `evidence` are sentences; of a skipped check, the reason. `remedy` is "" if there is nothing to
    do.
    """

    verdict: Verdict
    evidence: tuple[str, ...] = ()
    remedy: str = ""


def ok(*evidence: str) -> Finding:
    """Nothing is wrong."""
    return Finding("ok", evidence)


def skipped(reason: str) -> Finding:
    """The check could not be made, or does not apply."""
    return Finding("skipped", (reason,))


def found(verdict: Verdict, evidence: list[str], remedy: str, fine: str = "") -> Finding:
    """The verdict, if there is evidence; else ok, with `fine` as the evidence."""
    if not evidence:
        return ok(*filter(None, (fine,)))
    return Finding(verdict, tuple(evidence), remedy)


def first_of(sentences: list[str]) -> list[str]:
    """The first ten sentences, and how many more there are."""
    more = and_more(len(sentences), _MOST_SENTENCES)
    return [*sentences[:_MOST_SENTENCES], *filter(None, (more,))]
