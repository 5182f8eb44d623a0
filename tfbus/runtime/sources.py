"""Whether this tfbus is installed, or only a folder of sources that Python was started in."""

from importlib.util import find_spec
from pathlib import Path


def why_not_installed() -> str:
    """The missing part, and what to do, as a sentence; "" if tfbus is installed.

    Python imports first what lies in the folder it is started in. In a clone these are sources:
    they are not compiled, and the nodes lie elsewhere.
    """
    if find_spec("tfbus.nodes") is not None:
        return ""
    clone = Path(__file__).parents[2]
    return (
        f"Python has imported tfbus from the sources in {clone}, where it is neither compiled nor "
        "complete: start Python in another folder to use the installed one, or install the sources "
        "in place with: pip install --editable ."
    )
