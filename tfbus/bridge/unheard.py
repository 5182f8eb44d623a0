"""Publishers of a topic in ROS that are not heard."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tfbus.bridge.leg import RosTopic
from tfbus.wording import listed, printable


@dataclass(frozen=True)
class Offer:
    """How a node publishes a topic; `node` is "" if it has no name, `type` as the middleware
    names it.
    """

    node: str
    type: str
    is_reliable: bool
    is_retained: bool


def unheard(topic: RosTopic, own_type: str, offers: Iterable[Offer]) -> Sequence[str]:
    """The note on publishers whose messages do not come to a subscriber of the topic."""
    best_effort, volatile = [], []
    said = []
    for each in offers:
        name = printable(each.node or "a node without a name", 100)
        if each.type != own_type:
            shown = printable(each.type, 100)
            said.append(f"{name} publishes {topic.name} as {shown}, not {own_type}")
        elif not each.is_reliable:
            best_effort.append(name)
        elif topic.retained and not each.is_retained:
            volatile.append(name)
    if best_effort:
        said.append(
            f"{_publish(best_effort)} {topic.name} as best effort, and it is read as reliable: "
            "such messages do not come"
        )
    if volatile:
        said.append(
            f"{_publish(volatile)} {topic.name} as volatile, and it is read as transient local: "
            "such messages do not come"
        )
    return list(dict.fromkeys(said))


def _publish(nodes: Sequence[str]) -> str:
    """The nodes, each once, with their verb."""
    names = list(dict.fromkeys(nodes))
    return f"{listed(names)} {'publish' if names[1:] else 'publishes'}"
