"""The frames of a tree as the page shows them: with their states, in the order of their trees."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.errors import TransformException
from tfbus.frames.moment import Fault, State, silent_s, stale_after_s, state
from tfbus.frames.snapshot import FrameTree

# A stale frame fades to this opacity, over twice the time after which it was stale.
FADED = 0.25

# The states that mean that something is wrong.
FAULTS: tuple[Fault, ...] = ("conflict", "gone", "stale", "ahead")


@dataclass(frozen=True)
class ViewFrame:
    """A frame as the page shows it.

    `silent_s` is for how long a stale frame has had no sample, `ahead_s` how far in the future the
    newest stamp is of one that is ahead, else 0; `opacity` is from FADED to
    1. `publishers` are the streams that send it, several in a conflict. `depth` is the number of
    frames above it. `unplaced` says why it cannot be drawn, "" if it can.
    """

    info: FrameInfo
    state: State
    silent_s: float
    opacity: float
    publishers: tuple[str, ...]
    root: str
    depth: int
    unplaced: str = ""
    ahead_s: float = 0.0

    @property
    def name(self) -> str:
        """The frame's name."""
        return self.info.name


class Frames:
    """The frames at one moment: whole trees, the largest first, parents before their children."""

    def __init__(self, frames: Iterable[ViewFrame] = ()) -> None:
        self.by_name = {frame.name: frame for frame in frames}
        self.roots = [frame.name for frame in self if frame.depth == 0]

    def __len__(self) -> int:
        return len(self.by_name)

    def __iter__(self) -> Iterator[ViewFrame]:
        return iter(self.by_name.values())

    def __contains__(self, name: str) -> bool:
        return name in self.by_name

    def __getitem__(self, name: str) -> ViewFrame:
        return self.by_name[name]

    def tree_of(self, name: str) -> list[str]:
        """The frames of the tree that a frame is in; [] for an unknown frame."""
        if name not in self.by_name:
            return []
        root = self.by_name[name].root
        return [frame.name for frame in self if frame.root == root]

    def natural_fixed_frame(self) -> str:
        """The fixed frame if none is chosen: world, or the largest tree's root; "" for no frame."""
        if "world" in self.by_name:
            return "world"
        return next(iter(self.roots), "")


def frames_of(tree: FrameTree, buffer: Buffer, fixed_frame: str) -> Frames:
    """The frames of a tree, a snapshot of the buffer, to be seen from the fixed frame."""
    frames = []
    for whole in tree.trees:
        root = whole[0][1].name
        unplaced = _why_apart(buffer, fixed_frame, root)
        for depth, info in whole:
            judged = state(tree, info)
            silence_s, opacity = 0.0, FADED if judged == "gone" else 1.0
            if judged == "stale":
                silence_s = silent_s(tree, info) or 0.0
                opacity = fading(silence_s, stale_after_s(info))
            ahead_s = -(tree.age_s(info) or 0.0) if judged == "ahead" else 0.0
            publishers = tree.publishers(info)
            frames.append(
                ViewFrame(
                    info, judged, silence_s, opacity, publishers, root, depth, unplaced, ahead_s
                )
            )
    return Frames(frames)


def fading(silence_s: float, stale_after_s: float) -> float:
    """The opacity of a stale frame, from 1 down to FADED: lower the longer it is stale."""
    faded = min((silence_s - stale_after_s) / (2.0 * stale_after_s), 1.0)
    return 1.0 - (1.0 - FADED) * faded


def _why_apart(buffer: Buffer, fixed_frame: str, root: str) -> str:
    """Why a whole tree cannot be placed, in the buffer's words; "" if it can."""
    if not fixed_frame:
        return ""
    try:
        buffer.path(fixed_frame, root)
    except TransformException as error:
        return str(error)
    return ""
