"""The output of tools: tables, colours, YAML, and reports of measurements."""

from math import nan

import pytest

from tfbus.cli.output import as_text, paint, screen, table, yaml_text
from tfbus.cli.topic.measure import BANDWIDTH, DELAY, RATE
from tfbus.frames.windows import WindowReading


class TestTables:
    def test_columns_are_below_their_headings(self) -> None:
        """Columns are as wide as their widest cell; chosen ones are aligned to the right."""
        lines = table(["name", "rate"], [["turtle1", "62.5"], ["cam", "1.0"]], right=[1])
        assert [line.replace("\x1b[1m", "").replace("\x1b[0m", "") for line in lines] == [
            "name     rate",
            "turtle1  62.5",
            "cam       1.0",
        ]

    def test_the_widest_column_is_cut_to_fit(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """No line is longer than allowed; a cut cell ends with an ellipsis."""
        monkeypatch.setenv("NO_COLOR", "1")
        rows = [["a/very/long/name/of/a/topic", "62.500"]]
        assert table(["topic", "rate"], rows, longest=20) == [
            "topic         rate",
            "a/very/long…  62.500",
        ]
        assert table(["topic", "rate"], rows)[1] == "  ".join(rows[0])

    def test_names_are_cut_in_the_middle(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Where a column is of names: different ones stay different, with their ends if those tell
        them apart.
        """
        monkeypatch.setenv("NO_COLOR", "1")
        rows = [["robot7/left_wheel", "1.0"], ["robot7/right_wheel", "2.0"]]
        assert table(["frame", "rate"], rows, names=[0], longest=17)[1:] == [
            "…left_wheel  1.0",
            "…ight_wheel  2.0",
        ]
        rows = [["robot1/base_link", "1.0"], ["robot2/base_link", "2.0"]]
        assert table(["frame", "rate"], rows, names=[0], longest=13)[1:] == [
            "robot1…  1.0",
            "robot2…  2.0",
        ]
        rows = [[f"{side}/robot{number}/link", ""] for side in "ab" for number in (1, 2)]
        cut = table(["frame", ""], rows, names=[0], longest=8)
        assert len(set(cut)) == 5

    def test_a_painted_cell_is_cut_within_its_colour(self) -> None:
        """Colour takes no room, and ends with the cell."""
        (_, line) = table(["x"], [[paint("abcdef", "name")]], longest=4)
        assert line == paint("abc…", "name")

    def test_a_table_can_be_empty(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Without rows a table is its headings."""
        monkeypatch.setenv("NO_COLOR", "1")
        assert table(["a", "b"], []) == ["a  b"]


class TestText:
    def test_no_color_takes_the_colour_away(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """With NO_COLOR nothing is painted (https://no-color.org)."""
        assert paint("x", "bad") == "\x1b[31mx\x1b[0m"
        monkeypatch.setenv("NO_COLOR", "1")
        assert paint("x", "bad") == "x"

    def test_a_number_that_is_not_finite_is_named(self) -> None:
        """A text for people says nan, which JSON does not have."""
        assert [as_text(each) for each in (nan, 1.0, [nan])] == ["nan", "1.0", "[null]"]

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
        """Maps keep their order, texts their line; a scalar has no end mark."""
        assert yaml_text(value) == text


def test_a_page_that_is_shown_again_and_again_has_a_limit(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A bus with a million names does not fill a pipe twice a second."""
    with screen() as show:
        show(f"line {number}" for number in range(100_000))
    page = capsys.readouterr().out.splitlines()
    assert page[499:] == ["line 499", "… 99500 more lines", ""]


class TestReports:
    READING = WindowReading((1.0, 1.5, 2.0), (100.0, 100.0, 1300.0), 3)

    def test_a_rate_in_ros2s_words(self) -> None:
        """One over the mean interval, and the spread of the intervals."""
        numbers = RATE.numbers(self.READING, 3.0)
        assert numbers is not None
        assert RATE.lines(numbers) == [
            "average rate: 2.000",
            "\tmin: 0.500s max: 0.500s std dev: 0.00000s window: 3",
        ]
        assert RATE.row(numbers) == ["2.000", "0.50000", "0.50000", "0.00000", "3"]

    def test_a_bandwidth_in_ros2s_words(self) -> None:
        """Bytes per second over the window, and the sizes of messages."""
        numbers = BANDWIDTH.numbers(self.READING, 2.0)
        assert numbers is not None
        assert BANDWIDTH.lines(numbers) == [
            "1.50 KB/s from 3 messages",
            "\tMessage size mean: 500 B min: 100 B max: 1.30 KB",
        ]

    def test_a_delay_in_ros2s_words(self) -> None:
        """The mean of the delays, and their spread."""
        numbers = DELAY.numbers(WindowReading((1.0, 2.0), (0.25, 0.75), 2), 3.0)
        assert numbers is not None
        assert DELAY.lines(numbers) == [
            "average delay: 0.500",
            "\tmin: 0.250s max: 0.750s std dev: 0.25000s window: 2",
        ]

    def test_too_few_messages_are_no_report(self) -> None:
        """One message has no rate, and none has no delay."""
        one = WindowReading((1.0,), (1.0,), 1)
        assert (RATE.numbers(one, 2.0), BANDWIDTH.numbers(one, 2.0)) == (None, None)
        assert DELAY.numbers(WindowReading((), (), 0), 2.0) is None
