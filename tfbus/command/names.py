"""Names as the command line gives them: of frames, and of nodes that nobody named."""

import os


def frame_mistake(name: str) -> str:
    """What is wrong with a frame's name, and what to write instead; "" where nothing is."""
    if not name:
        return "a frame's name is not empty"
    if name.startswith("/"):
        return f"{name!r} begins with a slash, which frames do not: write {name.lstrip('/')!r}"
    return ""


def own_name(kind: str) -> str:
    """A node's name that no other process has: `echo_5d205229`."""
    return f"{kind}_{os.urandom(4).hex()}"
