"""Joints as one tree of links: its root, the order outwards, and which joint follows which."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from tfbus.errors import UrdfError
from tfbus.robot.model import Joint, Link
from tfbus.robot.xml import Element
from tfbus.wording import did_you_mean, listed, printable


@dataclass(frozen=True, slots=True)
class Placed:
    """A joint and the element that describes it, whose line mistakes are to name."""

    joint: Joint
    element: Element


def from_the_root(
    robot: Element, links: Mapping[str, Link], joints: list[Placed]
) -> tuple[str, tuple[Joint, ...]]:
    """The root link, and the joints outwards from it: a joint after all that carry it.

    Raises UrdfError where a link has two parents, or the links are not one tree.
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
        raise _cycle(next(name for name in links if name not in set(reached)), above)
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
    """Raise UrdfError where a joint mimics one that is none, has no position, or mimics it."""
    for each in joints.values():
        if each.joint.mimic is None:
            continue
        way = [each.joint.name]
        joint = each.joint
        while joint.mimic is not None:
            known = joints.get(joint.mimic.joint)
            if known is None:
                raise _mimic_mistake(
                    joints[joint.name],
                    f"no joint {_shown(joint.mimic.joint)}"
                    + did_you_mean(joint.mimic.joint, set(joints) - {joint.name}),
                )
            joint = known.joint
            if joint.name in way:
                names = " -> ".join(_shown(name) for name in [*way, joint.name][:8])
                raise _mimic_mistake(each, f"a cycle: {names}")
            way.append(joint.name)
        if joint.position_size != 1:
            raise _mimic_mistake(
                each,
                f"joint {_shown(joint.name)}, which is {joint.type}: it has no single position",
            )


def _mimic_mistake(at: Placed, reason: str) -> UrdfError:
    element = at.element.find("mimic") or at.element
    return element.mistake(f"joint {_shown(at.joint.name)} mimics {reason}")


def _shown(name: str) -> str:
    return f"'{printable(name, 60)}'"
