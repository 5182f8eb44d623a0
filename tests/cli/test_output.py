"""What tools print: tables, colours, YAML; and numbers of what is measured."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.cli.output import paint, table, yaml_text
from tfbus.cli.topic.reports import BANDWIDTH, DELAY, RATE
from tfbus.monitor.window import Reading, Window, spread_of
from tfbus.wording import did_you_mean


class TestTables:
    def test_columns_stand_below_their_headings(self) -> None:
        """Columns are as wide as their widest cell, numbers set to the right if wanted."""
        lines = table(["name", "rate"], [["turtle1", "62.5"], ["cam", "1.0"]], right=[1])
        assert [line.replace("\x1b[1m", "").replace("\x1b[0m", "") for line in lines] == [
            "name     rate",
            "turtle1  62.5",
            "cam       1.0",
        ]

    def test_the_widest_column_is_cut_to_fit(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """No line is longer than what there is room for; what is cut ends in an ellipsis."""
        monkeypatch.setenv("NO_COLOR", "1")
        rows = [["a/very/long/name/of/a/topic", "62.500"]]
        assert table(["topic", "rate"], rows, longest=20) == [
            "topic         rate",
            "a/very/long…  62.500",
        ]
        assert table(["topic", "rate"], rows)[1] == "a/very/long/name/of/a/topic  62.500"

    def test_a_painted_cell_is_cut_within_its_colour(self) -> None:
        """Colour takes no room, and ends where it is to end."""
        (_, line) = table(["x"], [[paint("abcdef", "name")]], longest=4)
        assert line == paint("abc…", "name")

    def test_a_table_may_be_empty(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Without rows there are only the headings."""
        monkeypatch.setenv("NO_COLOR", "1")
        assert table(["a", "b"], []) == ["a  b"]


class TestText:
    def test_no_color_takes_the_colour_away(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """With NO_COLOR nothing is painted, as https://no-color.org has it."""
        assert paint("x", "bad") == "\x1b[31mx\x1b[0m"
        monkeypatch.setenv("NO_COLOR", "1")
        assert paint("x", "bad") == "x"

    @pytest.mark.parametrize(
        ("value", "text"),
        [
            ({"x": 1.5, "l": [1, {"y": "a: b"}]}, "x: 1.5\nl:\n- 1\n- y: 'a: b'"),
            ("turtle", "turtle"),
            (5.5, "5.5"),
            ({"n": "long..."}, "n: long..."),
            ({"t": "word " * 40}, f"t: '{'word ' * 40}'"),
            ({}, "{}"),
        ],
    )
    def test_values_are_yaml(self, value: object, text: str) -> None:
        """Maps keep their order, texts their line; a value alone has no mark of its end."""
        assert yaml_text(value) == text

    def test_a_wrong_name_ends_with_what_there_is(self) -> None:
        """The name that may be meant, or some of those there are, or that there is none."""
        assert did_you_mean("pse", ["pose", "color"], none="") == "; did you mean 'pose'?"
        assert did_you_mean("x", ["pose", "color"], none="") == "; there are: color, pose"
        assert did_you_mean("x", [], none=", nor any other") == ", nor any other"
        assert did_you_mean("x", map("n{}".format, range(25)), none="").endswith(" and 5 more")


class TestNumbers:
    def test_the_spread_of_numbers(self) -> None:
        """Mean, bounds, deviation and percentiles, of numbers in any order."""
        spread = spread_of([4.0, 2.0, 2.0, 4.0])
        assert spread is not None
        assert (spread.count, spread.mean, spread.min, spread.max) == (4, 3.0, 2.0, 4.0)
        assert (spread.std_dev, spread.p50, spread.p99) == (1.0, 2.0, 4.0)
        assert spread_of([]) is None

    @given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
    def test_percentiles_are_numbers_of_the_list_in_order(self, numbers: list[float]) -> None:
        """A percentile is one of the numbers, and at least so many are not above it."""
        spread = spread_of(numbers)
        assert spread is not None
        assert spread.min <= spread.p50 <= spread.p95 <= spread.p99 <= spread.max
        for part, value in ((0.5, spread.p50), (0.95, spread.p95), (0.99, spread.p99)):
            assert value in numbers
            assert sum(number <= value for number in numbers) >= part * len(numbers) - 1e-9
        assert math.isclose(spread.mean, sum(numbers) / len(numbers), abs_tol=1e-6)

    def test_a_window_keeps_the_last(self) -> None:
        """A window forgets the oldest of more than it holds, and counts all."""
        window = Window(2)
        for at in range(3):
            window.add(float(at), 10.0 * at)
        reading = window.read()
        assert reading == Reading((1.0, 2.0), (10.0, 20.0), 3)
        assert reading.intervals_s == [1.0]


class TestReports:
    READING = Reading((1.0, 1.5, 2.0), (100.0, 100.0, 1300.0), 3)

    def test_a_rate_in_ros2s_words(self) -> None:
        """One over the mean interval, and how the intervals are spread."""
        numbers = RATE.numbers(self.READING, 3.0)
        assert numbers is not None
        assert RATE.lines(numbers) == [
            "average rate: 2.000",
            "\tmin: 0.500s max: 0.500s std dev: 0.00000s window: 3",
        ]
        assert RATE.row(numbers) == ["2.000", "0.50000", "0.50000", "0.00000", "3"]

    def test_a_bandwidth_in_ros2s_words(self) -> None:
        """Bytes since the first message of the window, and how large messages are."""
        numbers = BANDWIDTH.numbers(self.READING, 2.0)
        assert numbers is not None
        assert BANDWIDTH.lines(numbers) == [
            "1.50 KB/s from 3 messages",
            "\tMessage size mean: 500 B min: 100 B max: 1.30 KB",
        ]

    def test_a_delay_in_ros2s_words(self) -> None:
        """The mean of the delays, and how they are spread."""
        numbers = DELAY.numbers(Reading((1.0, 2.0), (0.25, 0.75), 2), 3.0)
        assert numbers is not None
        assert DELAY.lines(numbers) == [
            "average delay: 0.500",
            "\tmin: 0.250s max: 0.750s std dev: 0.25000s window: 2",
        ]

    def test_too_few_messages_are_no_report(self) -> None:
        """One message has no rate, and none has no delay."""
        one = Reading((1.0,), (1.0,), 1)
        assert (RATE.numbers(one, 2.0), BANDWIDTH.numbers(one, 2.0)) == (None, None)
        assert DELAY.numbers(Reading((), (), 0), 2.0) is None
