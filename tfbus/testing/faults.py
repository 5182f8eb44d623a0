"""Faults of Zenoh's that a simulated network can show, each as a share of the occasions."""

from dataclasses import dataclass


@dataclass
class Faults:
    """How often Zenoh fails in ways that it is known for: 0 never, 1 on each occasion.

    `lost_declarations`: a declaration of a queryable never arrives, at most one of each link
    (eclipse-zenoh/zenoh#2516).
    """

    lost_declarations: float = 0.0
