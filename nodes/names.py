"""Names as the command line gives them: of frames, and of nodes of which many run at once."""

import os

from tfbus import NodeSettings


def frame_mistake(name: str) -> str:
    """What is wrong with a frame's name, and what to write instead; "" where nothing is."""
    if not name:
        return "a frame's name is not empty"
    if name.startswith("/"):
        return f"{name!r} begins with a slash, which frames do not: write {name.lstrip('/')!r}"
    return ""


def named_apart(settings: NodeSettings, default_name: str) -> NodeSettings:
    """The settings with a name of this process's own, unless they have another than the default."""
    if settings.name != default_name:
        return settings
    return settings.renamed(f"{default_name}_{os.urandom(4).hex()}")
