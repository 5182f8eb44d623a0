"""Words in the sentences that people read."""


def counted(count: int, noun: str) -> str:
    """A number of things: `1 frame`, `2 frames`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
