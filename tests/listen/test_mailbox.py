"""Descriptions that wait to be read."""

from tfbus.listen.mailbox import Letter, Mailbox


def letter(sender: str, key: str = "k", payload: bytes = b"") -> Letter:
    return Letter(key, payload, sender)


def taken(mailbox: Mailbox) -> list[Letter]:
    return list(iter(mailbox.take, None))


def test_letters_of_a_sender_keep_their_order() -> None:
    """None is left out: what one description lists, and the next does not, was removed."""
    mailbox = Mailbox()
    sent = [letter("a", payload=bytes([number])) for number in range(100)]
    for each in sent:
        mailbox.put(each)
    assert taken(mailbox) == sent


def test_senders_have_their_turns() -> None:
    """However many keys one writes to, another waits for one letter at most."""
    mailbox = Mailbox()
    for number in range(1000):
        mailbox.put(letter("flood", f"k{number}"))
    mailbox.put(letter("honest"))
    assert [each.sender for each in taken(mailbox)[:3]] == ["flood", "honest", "flood"]


def test_there_is_room_for_so_many_bytes() -> None:
    """The oldest of the sender with the most bytes goes, never one of another."""
    mailbox = Mailbox(most_bytes=10_000)
    mailbox.put(letter("honest", payload=bytes(1000)))
    for number in range(100):
        mailbox.put(letter("flood", f"k{number}", bytes(500)))
    left = taken(mailbox)
    assert [each.key for each in left if each.sender == "flood"] == [
        f"k{n}" for n in range(92, 100)
    ]
    assert [each.sender for each in left].count("honest") == 1


def test_the_taking_begins_once_and_goes_on() -> None:
    """A letter that comes while another is read is read after it, without a second reader."""
    mailbox = Mailbox()
    assert mailbox.put(letter("a"))
    assert mailbox.take() == letter("a")
    assert not mailbox.put(letter("b"))
    assert mailbox.has_more()
    assert mailbox.take() == letter("b")
    assert not mailbox.has_more()
    assert mailbox.put(letter("a"))
