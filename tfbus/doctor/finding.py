"""What a check has found."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warn", "fail", "skipped"]


@dataclass(frozen=True)
class Finding:
    """The verdict of one check, what it rests on, and what to do about it.

    `evidence` are sentences; of a skipped check, the reason. `remedy` is "" where there is
    nothing to do.
    """

    verdict: Verdict
    evidence: tuple[str, ...] = ()
    remedy: str = ""


def ok(*evidence: str) -> Finding:
    """Nothing is wrong."""
    return Finding("ok", evidence)


def skipped(reason: str) -> Finding:
    """It could not be looked at, or does not apply."""
    return Finding("skipped", (reason,))


def found(verdict: Verdict, evidence: list[str], remedy: str, fine: str = "") -> Finding:
    """The verdict where there is evidence; ok, with `fine` as the evidence, where there is none."""
    if not evidence:
        return ok(*filter(None, (fine,)))
    return Finding(verdict, tuple(evidence), remedy)
