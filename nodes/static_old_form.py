"""Converts the arguments that static_transform_publisher took before it had flags."""

import shlex
from collections.abc import Sequence
from itertools import takewhile

_XYZ = ("x", "y", "z")
# The old form has yaw first.
_FIELDS_BY_COUNT = {6: (*_XYZ, "yaw", "pitch", "roll"), 7: (*_XYZ, "qx", "qy", "qz", "qw")}


def in_new_form(words: Sequence[str]) -> str:
    """`tfbus static` with the frames and numbers of `x y z yaw pitch roll FRAME CHILD` or of
    `x y z qx qy qz qw FRAME CHILD`, with or without ROS 1's period at the end; "" for others.
    """
    numbers = [*takewhile(_is_number, words)]
    frames, behind = words[len(numbers) :][:2], words[len(numbers) :][2:]
    fields = _FIELDS_BY_COUNT.get(len(numbers))
    if fields is None or len(frames) < 2 or len(behind) > 1 or not all(map(_is_number, behind)):
        return ""
    given = zip(fields, numbers, strict=True)
    flags = [word for name, text in given if float(text) for word in (f"--{name}", text)]
    return shlex.join(["tfbus", "static", *(frame.lstrip("/") for frame in frames), *flags])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
