"""Names that a recorder was given, and that nothing on the bus has."""

from collections.abc import Collection, Iterator, Mapping

from tfbus.bag.trigger import Condition
from tfbus.recording.selection import Selection
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import FrameNames, has_name
from tfbus.wire.keys import namespace_of_node
from tfbus.wording import did_you_mean, printable


def unmatched(
    selection: Selection,
    conditions: Collection[Condition],
    described: Mapping[str, StreamDescription],
    received: Collection[str],
) -> Iterator[str]:
    """A clause for each stream and frame that is asked for and that nothing is called; `described`
    are the streams that there were, `received` those of which messages came. A frame may come in a
    stream without a description: then nothing is said.
    """
    known = {*described, *received}
    for name in selection.streams:
        if name not in known:
            yield f"no stream is called '{printable(name, 60)}'{did_you_mean(name, known)}"
    if set(received) - set(described):
        return
    frames = {
        (namespace_of_node(each.node), child)
        for each in described.values()
        for _, child, _ in each.frames
    }
    in_fleet = {FrameNames(namespace).outside(child) for namespace, child in frames}
    asked = [*selection.frames, *(each.frame for each in conditions if each.frame)]
    for name in dict.fromkeys(asked):
        if not any(has_name(child, namespace, name) for namespace, child in frames):
            yield f"no frame is called '{printable(name, 60)}'{did_you_mean(name, in_fleet)}"
