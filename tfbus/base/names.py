"""Names of frames: which texts can be one, and why another cannot."""

from tfbus.base.wording import printable

# Longer ones come from a mistake or an attack: they would fill screens, messages and memory.
MOST_LETTERS = 255


def mistake_in(name: object) -> str:
    """Why this cannot be the name of a frame, as the end of a sentence that begins with the kind of
    the name; "" if it can.
    """
    if not isinstance(name, str):
        return f"must be a str such as 'base_link', not {type(name).__name__}"
    if name.isprintable() and 0 < len(name) <= MOST_LETTERS and name[0] != "/":
        return ""  # nearly all, and each transform that is made asks for two
    if not name:
        return "must not be empty"
    shown = f"'{printable(name, most=60)}'"
    if name[0] == "/":
        return f"{shown} begins with a slash; write '{printable(name.lstrip('/'), most=60)}'"
    if len(name) > MOST_LETTERS:
        return f"{shown} has {len(name)} letters; at most {MOST_LETTERS} are allowed"
    letter = next(letter for letter in name if not letter.isprintable())
    return (
        f"{shown} contains U+{ord(letter):04X}, which cannot be printed: use letters, digits, "
        "spaces and signs"
    )


def is_printable(name: str) -> bool:
    """Whether a name of something else, such as a stream or a node, can be shown and is not too
    long.
    """
    return len(name) <= MOST_LETTERS and name.isprintable()
