"""Joints as one tree of links: its root, the order outwards, and which joint follows which."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from tfbus.errors import UrdfError
from tfbus.names import MOST_LETTERS
from tfbus.robot.model import Joint, Link
from tfbus.robot.xml import Element
from tfbus.wording import did_you_mean, listed, printable

# To find the nearest of more names takes seconds.
_MOST_COMPARED = 5000


@dataclass(frozen=True, slots=True)
class Placed:
    """A joint and the element that describes it, whose line mistakes are to name."""

    joint: Joint
    element: Element


def from_the_root(
    robot: Element, links: Mapping[str, Link], joints: list[Placed]
) -> tuple[str, tuple[Joint, ...]]:
    """The root link, and the joints outwards from it: a joint after all that carry it.

    Raises UrdfError if a link has two parents, or the links are not one tree.
    """
    above: dict[str, Placed] = {}
    below: dict[str, list[Joint]] = defaultdict(list)
    for each in joints:
        joint = each.joint
        if joint.child in above:
            raise each.element.mistake(
                f"joint {_shown(joint.name)}: link {_shown(joint.child)} is already the child of "
                f"joint {_shown(above[joint.child].joint.name)}; a link has one parent"
            )
        above[joint.child] = each
        below[joint.parent].append(joint)
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise robot.mistake(
            f"{len(roots)} links have no parent: {listed([_shown(name) for name in roots])}; all "
            "links but one must be the child of a joint"
        )
    down: list[Joint] = []
    reached = list(roots)
    for link in reached:
        down += below[link]
        reached += [joint.child for joint in below[link]]
    if len(reached) < len(links):
        known = set(reached)
        raise _cycle(next(name for name in links if name not in known), above)
    return roots[0], tuple(down)


def _cycle(link: str, above: Mapping[str, Placed]) -> UrdfError:
    """The mistake that upwards of this link there is no end."""
    way = [link]
    seen = {link}
    while (link := above[link].joint.parent) not in seen:
        way.append(link)
        seen.add(link)
    cycle = [*way[way.index(link) :], link]
    names = " -> ".join(_shown(name) for name in cycle[:8]) + (" ..." if len(cycle) > 8 else "")
    at = above[link]
    return at.element.mistake(f"joint {_shown(at.joint.name)} closes a cycle of links: {names}")


def check_mimics(joints: Mapping[str, Placed]) -> None:
    """Raise UrdfError if a joint mimics one that is none, has no position, or mimics it."""
    checked: set[str] = set()
    for each in joints.values():
        joint, way = each.joint, dict.fromkeys([each.joint.name])
        while joint.mimic is not None and joint.name not in checked:
            known = joints.get(joint.mimic.joint)
            if known is None:
                others = set(joints) - {joint.name}
                raise _mimic_mistake(
                    joints[joint.name],
                    f"no joint {_shown(joint.mimic.joint)}{near(joint.mimic.joint, others)}",
                )
            joint = known.joint
            if joint.name in way:
                names = " -> ".join(_shown(name) for name in [*way, joint.name][:8])
                raise _mimic_mistake(each, f"a cycle: {names}")
            way[joint.name] = None
        if joint.mimic is None and joint is not each.joint and joint.position_size != 1:
            raise _mimic_mistake(
                each,
                f"joint {_shown(joint.name)}, which is {joint.type}: it has no single position",
            )
        checked.update(way)


def _mimic_mistake(at: Placed, reason: str) -> UrdfError:
    element = at.element.find("mimic") or at.element
    return element.mistake(f"joint {_shown(at.joint.name)} mimics {reason}")


def near(name: str, known: Collection[str]) -> str:
    """The end of a sentence about a name that is not known: `; did you mean ...`."""
    if not 0 < len(name) <= MOST_LETTERS or len(known) > _MOST_COMPARED:
        return ""
    return did_you_mean(name, known)


def _shown(name: str) -> str:
    return f"'{printable(name, 60)}'"
