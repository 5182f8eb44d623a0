"""Links as Zenoh tells of them: lost and half linked processes."""

from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from tfbus.bus.links import LinkEnds, Links

OLD = LinkEnds("tcp/10.0.0.1:4000", "tcp/10.0.0.2:7447")
NEW = LinkEnds("tcp/10.0.0.1:7447", "tcp/10.0.0.2:5000")


def told(*steps: tuple[str, str, LinkEnds | None]) -> Links:
    """Links after events: "+" or "-", an id, and a link, or None for the connection."""
    links = Links()
    tell(links, *steps)
    return links


def tell(links: Links, *steps: tuple[str, str, LinkEnds | None]) -> None:
    """Tell of further events."""
    for sign, zid, link in steps:
        kind = zenoh.SampleKind.PUT if sign == "+" else zenoh.SampleKind.DELETE
        one: Any = SimpleNamespace(zid=zid, src=link and link.src, dst=link and link.dst)
        event: Any = SimpleNamespace(kind=kind, transport=one, link=one)
        (links.note_transport if link is None else links.note_link)(event)


@pytest.mark.parametrize(
    ("src", "dst", "expected"),
    [
        ("tcp/127.0.0.1:4000", "tcp/127.0.0.1:7447", True),
        ("tcp/[::1]:4000", "tcp/[::1]:7447", True),
        # Peers of one host that have met by multicast.
        ("tcp/10.0.0.1:4000", "tcp/10.0.0.1:41234", True),
        ("tcp/[::ffff:10.0.0.1]:4000", "tcp/10.0.0.1:41234", True),
        ("tcp/10.0.0.1:4000", "tcp/10.0.0.2:7447", False),
    ],
)
def test_a_link_is_within_a_host_by_its_addresses(src: str, dst: str, expected: bool) -> None:
    """On loopback, or from an address to the same one: what a network needs it does not."""
    assert LinkEnds(src, dst).is_within_host is expected


def test_a_process_is_linked_until_its_connection_ends() -> None:
    """A connection with its link comes and goes: the process is lost, at its endpoint."""
    links = told(("+", "a", None), ("+", "a", OLD))
    assert links.poll().new == {OLD}
    assert "a" in links
    tell(links, ("-", "a", None))
    assert links.poll().lost == {"a": OLD.dst}
    assert not links


def test_a_link_ends_before_its_connection_does() -> None:
    """A lost link is told at once, be it as short as it may: its connection may end much later."""
    links = told(("+", "a", None), ("+", "a", OLD), ("-", "a", OLD))
    changes = links.poll()
    assert (changes.ended, changes.lost) == ({OLD}, {})
    tell(links, ("-", "a", None))
    changes = links.poll()
    assert (changes.ended, changes.lost) == (set(), {"a": OLD.dst})


def test_a_link_that_joins_one_that_is_lost_is_half() -> None:
    """A link added to a connection whose former link is lost knows nothing of what was declared."""
    links = told(("+", "a", None), ("+", "a", OLD))
    links.poll()
    tell(links, ("+", "a", NEW), ("-", "a", OLD))
    assert links.poll().half == {NEW}


TCP = LinkEnds("tcp/10.0.0.1:4000?rel=1", "tcp/10.0.0.2:7447?rel=1")
AGAIN = LinkEnds("tcp/10.0.0.1:4001?rel=1", "tcp/10.0.0.2:7447?rel=1")
DATAGRAMS = LinkEnds("udp/10.0.0.1:4000?rel=0", "udp/10.0.0.2:7447?rel=0")


def test_datagrams_come_and_go() -> None:
    """A link of datagrams beside another one carries nothing that must arrive: its loss is none."""
    links = told(("+", "a", None), ("+", "a", TCP), ("+", "a", DATAGRAMS), ("-", "a", DATAGRAMS))
    changes = links.poll()
    assert (changes.new, changes.half, changes.ended, changes.datagrams) == ({TCP}, *[set()] * 3)


def test_datagrams_are_no_first_link() -> None:
    """Of a connection that began by datagrams no link stays, and of its host nothing is heard by
    them but their end; of one that was there before the order is not known.
    """
    links = told(("+", "a", None), ("+", "a", DATAGRAMS), ("+", "a", TCP))
    changes = links.poll()
    assert (changes.half, changes.datagrams) == ({TCP}, {DATAGRAMS})
    assert links.hosts_for_datagrams() == (set(), {"10.0.0.2"})
    links = told(("+", "a", None), ("+", "a", DATAGRAMS), ("+", "a", TCP))
    links.end_history()
    assert links.poll().half == set()
    assert links.hosts_for_datagrams() == ({"10.0.0.2"}, set())


def test_datagrams_are_not_taken_from_the_end_of_a_connection_on() -> None:
    """Its next one could begin by them: its host is left out before the changes are polled."""
    links = told(("+", "a", None), ("+", "a", TCP))
    links.poll()
    tell(links, ("-", "a", None))
    assert links.hosts_for_datagrams() == (set(), set())
    assert links.poll().lost == {"a": TCP.dst}


def test_datagrams_alone_are_half_a_connection() -> None:
    """Where the other link is lost, what it carried is lost: the datagrams end, and so does a new
    link that is added to them, however often one comes.
    """
    links = told(("+", "a", None), ("+", "a", TCP), ("+", "a", DATAGRAMS))
    links.poll()
    tell(links, ("-", "a", TCP))
    assert links.poll().datagrams == {DATAGRAMS}
    tell(links, ("+", "a", AGAIN))
    changes = links.poll()
    assert (changes.half, changes.datagrams) == ({AGAIN}, {DATAGRAMS})
    tell(links, ("-", "a", None), ("+", "a", None), ("+", "a", TCP), ("+", "a", DATAGRAMS))
    changes = links.poll()
    assert (changes.half, changes.datagrams) == (set(), set())


def test_a_link_that_comes_after_the_last_was_lost_is_left_to_zenoh() -> None:
    """A link added to a connection that has lost its last one ends with it, and is not half."""
    links = told(("+", "a", None), ("+", "a", OLD))
    links.poll()
    tell(links, ("-", "a", OLD), ("+", "a", NEW))
    assert links.poll().half == set()
    tell(links, ("-", "a", None))
    assert links.poll().lost == {"a": NEW.dst}


def test_two_links_of_two_that_connect_at_once_are_whole() -> None:
    """Two processes that connect to each other at once have two links, and both count."""
    links = told(("+", "a", None), ("+", "a", OLD), ("+", "a", NEW))
    changes = links.poll()
    assert (changes.half, changes.new) == (set(), {OLD, NEW})


def test_a_process_that_comes_back_is_whole() -> None:
    """A connection that ended and began anew is a whole one."""
    links = told(("+", "a", None), ("+", "a", OLD), ("-", "a", OLD), ("-", "a", None))
    tell(links, ("+", "a", None), ("+", "a", NEW))
    changes = links.poll()
    assert (changes.half, changes.lost) == (set(), {})


def test_a_link_that_is_told_after_its_connection_ended_is_none() -> None:
    """Events may come late: a process whose connection has ended is not linked."""
    links = told(("+", "a", None), ("-", "a", None), ("+", "a", OLD))
    links.poll()
    assert "a" not in links
