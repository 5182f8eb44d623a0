"""Plans of histories: the draws of a seed before the history runs."""

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Action:
    """One thing that happens: `kind` to `who`, with `args`, at a time."""

    at_s: float
    kind: str
    who: str
    args: tuple[Any, ...] = ()

    def __str__(self) -> str:
        words = " ".join(map(str, self.args))
        return f"{self.at_s:9.3f} s  {self.kind} {self.who} {words}".rstrip()


@dataclass(frozen=True)
class Size:
    """The bounds within which a plan is drawn; times in seconds.

    `period_s` are those of the publishers' messages, `look_s` is how often the laws are checked.
    """

    hosts: tuple[int, int]
    publishers: tuple[int, int]
    listeners: tuple[int, int]
    actions: tuple[int, int]
    seconds: float
    periods_s: tuple[float, ...]
    cache_s: float
    look_s: float


SMALL = Size((2, 3), (1, 3), (1, 2), (2, 18), 20.0, (0.15, 0.4, 1.0), 10.0, 0.5)
LARGE = Size((20, 20), (190, 190), (10, 10), (100, 150), 3600.0, (20.0, 30.0, 60.0), 120.0, 30.0)

# How often each kind of action is drawn.
_KINDS = {
    "static": 4,
    "remove_static": 2,
    "remove": 3,
    "kill": 1,
    "close": 1,
    "power_off": 1,
    "restart": 3,
    "fail_over": 2,
    "twin": 1,
    "stop": 3,
    "partition": 2,
    "flap": 2,
    "cut": 2,
    "heal": 3,
    "clock": 1,
    "slow": 2,
    "restart_listener": 2,
    "close_listener": 1,
    "listen_again": 1,
}
_OF_PUBLISHERS = frozenset(
    ("static", "remove_static", "remove", "kill", "close", "restart", "fail_over", "twin")
)
# A stream of this slot has no token and no description, as that of a plain program.
PLAIN = "plain"

_OF_LISTENERS = frozenset(("restart_listener", "close_listener", "listen_again"))
# How often each fault of Zenoh's is drawn, and its largest share.
_FAULTS = {
    "lost_declarations": (0.5, 0.3),
    "half_links": (0.25, 1.0),
    "late_tokens": (0.25, 0.5),
    "repeated_tokens": (0.25, 0.5),
    "short_queries": (0.25, 0.1),
    "endless_queries": (0.25, 0.1),
}
# Drawn apart, as it came later.
_DEAF_LINKS = (0.25, 0.2)
_CLOCK_STEPS_S = (0.4, 3.0, 30.0, 90.0, 4000.0)


@dataclass(frozen=True)
class Plan:
    """All of a history: the hosts of its publishers and listeners, and its actions.

    `listeners` has for each its host, how many seconds of history it asks for, and whether a second
    listener of its node reads by interest. `faults` are those of Zenoh, each with its share, as
    fields of `tfbus.testing.fabric.Faults`. `stalls` is the chance of a task at each of its steps
    to get no processor for a while.
    """

    seed: int
    size: Size
    hosts: tuple[str, ...]
    publishers: dict[str, str]
    listeners: dict[str, tuple[str, float, bool]]
    actions: tuple[Action, ...]
    period_s: float = 0.1
    faults: tuple[tuple[str, float], ...] = ()
    stalls: float = 0.0
    rule: str = "first"

    @classmethod
    def drawn(cls, seed: int, size: Size = SMALL) -> "Plan":
        """The plan of a seed."""
        draw = random.Random(seed)
        hosts = tuple(f"h{number}" for number in range(draw.randint(*size.hosts)))
        senders = {f"p{n}": draw.choice(hosts) for n in range(draw.randint(*size.publishers))}
        if draw.random() < 0.4:
            senders[PLAIN] = draw.choice(hosts)
        readers = {
            f"l{n}": (draw.choice(hosts), draw.choice((0.0, 0.0, 5.0)), draw.random() < 0.3)
            for n in range(draw.randint(*size.listeners))
        }
        found = [
            Action(round(draw.uniform(0.0, 0.1 * size.seconds), 3), "start", who)
            for who in (*senders, *readers)
        ]
        for _ in range(draw.randint(*size.actions)):
            found += _drawn_actions(draw, hosts, senders, readers, size.seconds)
        if draw.random() < 0.5:
            found += _joins_at_last(draw, list(readers), size.seconds)
        apart = random.Random(f"{seed}, apart")
        # Small ones have it often enough, and what is drawn apart changes no other draw.
        if size is SMALL and PLAIN in senders and apart.random() < 0.6:
            found += _overtakes(apart, senders, readers, size.seconds)
        apart = random.Random(f"{seed}, removed")
        if size is SMALL and apart.random() < 0.3:
            found += _joins_as_one_removes(apart, senders, readers, size.seconds)
        apart = random.Random(f"{seed}, deaf")
        deaf = _DEAF_LINKS[1] * apart.random() if apart.random() < _DEAF_LINKS[0] else 0.0
        return cls(
            seed,
            size,
            hosts,
            senders,
            readers,
            tuple(sorted(found, key=lambda each: each.at_s)),
            period_s=draw.choice(size.periods_s),
            faults=tuple(
                (fault, round(share * draw.random(), 3))
                for fault, (chance, share) in _FAULTS.items()
                if draw.random() < chance
            )
            + ((("deaf_links", round(deaf, 3)),) if deaf else ()),
            stalls=draw.choice((0.0, 0.0, 0.001, 0.01)),
            rule=draw.choice(("first", "priority")),
        )

    def only(self, actions: Iterable[Action]) -> "Plan":
        """The same plan with some of its actions."""
        return replace(self, actions=tuple(actions))

    def __str__(self) -> str:
        rows = [
            f"seed {self.seed}: publishers {self.publishers}, listeners {self.listeners}, "
            f"rule {self.rule}, stalls {self.stalls}, "
            f"faults {dict(self.faults)}"
        ]
        return "\n".join([*rows, *map(str, self.actions)])


# The host of each publisher; and of each listener with its other choices.
_Senders = dict[str, str]
_Readers = dict[str, tuple[str, float, bool]]


def _drawn_actions(
    draw: random.Random,
    hosts: tuple[str, ...],
    senders: _Senders,
    readers: _Readers,
    end_s: float,
) -> list[Action]:
    """An action, or a few that follow each other closely: faults that meet are worse."""
    at_s = round(draw.uniform(1.0, end_s), 3)
    kind = draw.random()
    if kind < 0.1:
        return _join_and_remove(draw, at_s, hosts, senders, readers)
    if kind < 0.15:
        return _die_and_return(draw, at_s, senders)
    found = [_drawn_action(draw, at_s, hosts, senders, readers)]
    while draw.random() < 0.3:
        at_s = round(at_s + draw.choice((0.01, 0.1, 1.0, 3.0)) * draw.uniform(0.5, 1.5), 3)
        found.append(_drawn_action(draw, at_s, hosts, senders, readers))
    return found


def _joins_at_last(draw: random.Random, readers: list[str], end_s: float) -> list[Action]:
    """Listeners join when hardly anything more happens that would tell them what they missed."""
    return [
        Action(round(draw.uniform(0.9, 1.1) * end_s, 3), "restart_listener", who) for who in readers
    ]


def _join_and_remove(
    draw: random.Random, at_s: float, hosts: tuple[str, ...], senders: _Senders, readers: _Readers
) -> list[Action]:
    """A listener joins over a slow path, and frames are removed before it knows them."""
    # A kept message is overtaken by the news of the removal, most of all where it waits for room.
    keeping = [who for who, (_, history_s, _) in readers.items() if history_s]
    reader = draw.choice(keeping or [*readers])
    here = readers[reader][0]
    delay_s, rate = round(draw.uniform(0.1, 1.5), 3), draw.choice((0, 2_000, 5_000))
    others = {host for host in senders.values() if host != here} or {*hosts} - {here}
    found = [Action(at_s, "slow", here, (other, delay_s, 0.0, rate)) for other in sorted(others)]
    found.append(Action(at_s, draw.choice(("restart_listener", "listen_again")), reader))
    for sender in draw.sample([*senders], min(len(senders), 3)):
        soon_s = round(at_s + draw.uniform(0.5, 2.5) * delay_s, 3)
        if draw.random() < 0.7:
            found.append(Action(soon_s, "remove", sender))
        else:
            found.append(Action(soon_s, "fail_over", sender, (draw.choice(sorted(others)),)))
    return found


def _die_and_return(draw: random.Random, at_s: float, senders: _Senders) -> list[Action]:
    """A publisher ends for a while, and the process that begins anew sends less than it did."""
    sender = draw.choice([*senders])
    killed_s = at_s + draw.uniform(0.5, 2.0)
    back_s = killed_s + draw.uniform(5.0, 8.0)
    return [
        Action(at_s, "static", sender, (draw.choice((1, 2)),)),
        Action(round(killed_s, 3), draw.choice(("kill", "close")), sender),
        Action(round(back_s, 3), "restart", sender),
    ]


def _overtakes(
    draw: random.Random, senders: _Senders, readers: _Readers, end_s: float
) -> list[Action]:
    """A plain stream goes on nearby, twice, while what it sent from afar is still under way."""
    far, near = senders[PLAIN], readers[draw.choice([*readers])][0]
    if far == near:
        return []
    found, at_s = [], round(draw.uniform(3.0, 0.5 * end_s), 3)
    for turn_s in (at_s, round(at_s + 7.5, 3)):
        delay_s = round(draw.uniform(1.0, 2.5), 3)
        found += [
            Action(turn_s, "slow", near, (far, 0.02, 0.0, 0)),
            Action(turn_s, "fail_over", PLAIN, (far,)),
            # By now it is known, and its messages come.
            Action(round(turn_s + 2.5, 3), "slow", near, (far, delay_s, 0.0, 0)),
            Action(round(turn_s + 2.5 + delay_s, 3), "fail_over", PLAIN, (near,)),
        ]
    return found


def _joins_as_one_removes(
    draw: random.Random, senders: _Senders, readers: _Readers, end_s: float
) -> list[Action]:
    """A frame is removed between a kept message, which is slow, and the list that has it no more,
    and hardly anything more happens that would tell.
    """
    pairs = [
        (who, host, sender, far)
        for who, (host, history_s, _) in readers.items()
        for sender, far in senders.items()
        if history_s and sender != PLAIN and far != host
    ]
    if not pairs:
        return []
    reader, here, sender, far = draw.choice(pairs)
    at_s, delay_s = round(draw.uniform(0.7, 0.9) * end_s, 3), round(draw.uniform(0.3, 1.5), 3)
    return [
        Action(at_s, "slow", here, (far, delay_s, 0.0, draw.choice((0, 2_000)))),
        Action(at_s, "listen_again", reader),
        Action(round(at_s + draw.uniform(0.5, 1.3) * delay_s, 3), "remove", sender),
    ]


def _drawn_action(
    draw: random.Random, at_s: float, hosts: tuple[str, ...], senders: _Senders, readers: _Readers
) -> Action:
    kind = draw.choices([*_KINDS], [*_KINDS.values()])[0]
    who = draw.choice(hosts)
    args: tuple[Any, ...] = ()
    if kind in _OF_PUBLISHERS:
        who = draw.choice([*senders])
    if kind in _OF_LISTENERS:
        who = draw.choice([*readers])
    if kind in ("static", "remove_static"):
        args = (draw.randrange(3),)
    elif kind in ("fail_over", "twin"):
        args = (draw.choice(hosts),)
    elif kind == "stop":
        who = draw.choice([*senders, *readers])
        args = (round(draw.choice((0.3, 1.0, 2.0, 5.0)) * draw.uniform(0.5, 1.5), 3),)
    elif kind == "flap":
        args = (round(draw.uniform(0.1, 2.5), 3),)
    elif kind == "clock":
        args = (round(draw.choice(_CLOCK_STEPS_S) * draw.uniform(-1, 1), 3),)
    elif kind == "cut":
        who, other = draw.sample(hosts, 2)
        args = (other,)
    elif kind == "slow":
        who, other = draw.sample(hosts, 2)
        args = (
            other,
            round(draw.choice((0.02, 0.2, 1.0)) * draw.uniform(0.5, 1.5), 3),
            round(draw.choice((0.0, 0.1, 0.3)) * draw.uniform(0.5, 1.0), 3),
            draw.choice((0, 0, 5_000, 50_000)),
        )
    elif kind == "heal":
        who = "all"
    return Action(at_s, kind, who, args)
