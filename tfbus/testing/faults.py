"""Faults of Zenoh's that a simulated network can show, each as a share of the occasions."""

from dataclasses import dataclass


@dataclass
class Faults:
    """How often Zenoh fails in ways that it is known for: 0 never, 1 on each occasion.

    - `lost_declarations`: a declaration of a queryable never arrives, at most one of each link
      (eclipse-zenoh/zenoh#2516).
    - `half_links`: of two that have lost each other, one links again before the other has noticed,
      and learns nothing of what that one has declared (eclipse-zenoh/zenoh#2806). It lasts for the
      lease, after which tfbus ends such a link (docs/internals/zenoh.md).
    - `late_tokens`: the news of a token comes up to a second late, after messages of its publisher,
      as was seen of hosts that are plugged in again.
    - `repeated_tokens`: the news of a token comes twice (eclipse-zenoh/zenoh#1438, #2071, #2523).
    - `short_queries`: the end of a query overtakes an answer, which is lost
      (eclipse-zenoh/zenoh-python#277).
    - `endless_queries`: the end of a query never comes, so that it ends by its timeout
      (eclipse-zenoh/zenoh#2454).
    """

    lost_declarations: float = 0.0
    half_links: float = 0.0
    late_tokens: float = 0.0
    repeated_tokens: float = 0.0
    short_queries: float = 0.0
    endless_queries: float = 0.0
