"""Why the buffer is interpreted, if it could not be compiled when tfbus was installed."""

from pathlib import Path

# What setup.py writes beside the modules that it could not compile; pip hides what it says.
_REASON = Path(__file__).parents[1] / "not_compiled.txt"

SLOWER = "lookups take about 70 times as long"


class InterpretedWarning(RuntimeWarning):
    """tfbus was to be compiled, and is not."""


def why_interpreted() -> str:
    """Why the compiler failed, as a sentence and the way out; "" if that was not tried.

    Of interest if the buffer is interpreted: the reason stays if it was compiled later.
    """
    try:
        reason = _REASON.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
    return (
        f"tfbus runs without its compiled kernel, and {SLOWER}: {reason}. Install a C compiler and "
        "the headers of Python, then: pip install --force-reinstall --no-deps --no-cache-dir tfbus"
    )
