"""How many transforms there are, in the same words for all commands of recordings."""


def counted_transforms(dynamic: int, static: int) -> str:
    """`9,000 dynamic and 2 static transforms`; each static frame of a stream counts once, however
    often its transform is repeated.
    """
    if not static:
        return many(dynamic, "dynamic transform")
    text = many(static, "static transform")
    return f"{dynamic:,} dynamic and {text}" if dynamic else text


def many(count: int, noun: str) -> str:
    """A number of things, with commas: `9,000,000 transforms`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
