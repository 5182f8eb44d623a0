"""Tables of a bounded size."""

from tfbus.base.bounded import Bounded, MadeOf


def test_the_item_that_was_assigned_longest_ago_goes() -> None:
    """An item that is assigned again stays, and a look at one does not keep it."""
    table: Bounded[str, int] = Bounded(2)
    table["a"] = 1
    table["b"] = 2
    table["a"] = 3
    assert table["b"] == 2
    table["c"] = 4
    assert dict(table) == {"a": 3, "c": 4}


def test_items_that_go_are_counted_and_handed_on() -> None:
    """Items that are removed by others are not."""
    gone: list[tuple[int, str]] = []
    table: Bounded[int, str] = Bounded(1, lambda key, value: gone.append((key, value)))
    table[1] = "one"
    table[2] = "two"
    del table[2]
    table[3] = "three"
    assert table.evicted == 1
    assert gone == [(1, "one")]


def test_a_table_is_filled_in_other_ways_too() -> None:
    """`update` and `setdefault` leave no more items than there may be."""
    table: Bounded[int, int] = Bounded(2)
    table.update({1: 1, 2: 2, 3: 3})
    table.setdefault(4, 4)
    assert list(table) == [3, 4]


def test_what_was_made_is_found_by_the_same_object_only() -> None:
    """An equal object is another one; with another hash of how it was made, too."""
    made: MadeOf[str] = MadeOf(10)
    one, equal = (1, [2]), (1, [2])
    assert made.keep("of one", one, True) == "of one"
    assert [made.get(one, True), made.get(one, False), made.get(equal, True)] == [
        "of one",
        None,
        None,
    ]


def test_an_object_that_is_kept_keeps_its_identity() -> None:
    """So no later object is taken for it; beyond the limit all are let go."""
    made: MadeOf[int] = MadeOf(3)
    for number in range(100):
        given = (number, object())
        assert made.get(given) is None
        assert made.keep(number, given) == made.get(given) == number
