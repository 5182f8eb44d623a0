"""The screen: four tables, a filter, and the details of one frame. Drawn by Textual."""

import asyncio
from typing import Any, ClassVar

from rich.text import Text
from textual import work
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.coordinate import Coordinate
from textual.screen import ModalScreen
from textual.widgets import (
    DataTable,
    Footer,
    Input,
    Label,
    Sparkline,
    Static,
    TabbedContent,
    TabPane,
)

from tfbus.base.signals import StopSignals, held_signals
from tfbus.base.wording import counted, duration
from tfbus.frames.moment import State
from tfbus.frames.report import EDGES, STREAMS, Column
from tfbus.top.rows import Row, ScreenTable, TopSource, chosen, fitting, is_service

_LOOK_EVERY_S = 1.0
_HINT_EVERY_S = 2.0
# A screen shows some fifty rows, and each costs time and memory: filter to see others.
_MOST_ROWS = 500
_NAMES = ("frames", "streams", "nodes", "topics")
_STYLES: dict[State, str] = {
    "static": "dim",
    "stale": "yellow",
    "ahead": "cyan",
    "gone": "red",
    "conflict": "magenta",
}


class FrameScreen(ModalScreen[None]):
    """A frame: its rate and delay over the last two minutes, and all facts."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q", "dismiss", "Back"),
    ]
    CSS = """
    FrameScreen { align: center middle; }
    FrameScreen VerticalScroll {
        width: 90%; max-width: 110; height: 90%; max-height: 26;
        border: round $accent; padding: 0 1;
    }
    FrameScreen Sparkline { height: 3; margin-bottom: 1; }
    """

    def __init__(self, source: TopSource, frame: str):
        super().__init__()
        self._source = source
        self._frame = frame

    def compose(self) -> ComposeResult:
        with VerticalScroll():
            yield Label(Text(self._frame, style="bold"))
            yield Label("", id="rate")
            yield Sparkline([], id="rates")
            yield Label("", id="delay")
            yield Sparkline([], id="delays")
            yield Static("", id="details")
        yield Footer()

    def on_mount(self) -> None:
        self._show()
        self.set_interval(_LOOK_EVERY_S, self._show)

    def _show(self) -> None:
        past = self._source.past(self._frame)
        # A root and a static frame have none.
        is_dynamic = any(past.rates_hz)
        for part in ("rate", "delay"):
            self.query_one(f"#{part}", Label).display = is_dynamic
            self.query_one(f"#{part}s", Sparkline).display = is_dynamic
        if is_dynamic:
            since = f"the last {len(past.rates_hz)} s:"
            rate, delay = f"{past.rates_hz[-1]:.1f} Hz", duration(past.delays_s[-1])
            self.query_one("#rate", Label).update(f"Rate {rate}, mean of 10 s; {since}")
            self.query_one("#delay", Label).update(f"Delay {delay}, median of 10 s; {since}")
            self.query_one("#rates", Sparkline).data = list(past.rates_hz)
            self.query_one("#delays", Sparkline).data = list(past.delays_s)
        lines = "\n".join(line.strip() for line in self._source.details(self._frame))
        self.query_one("#details", Static).update(Text(lines))


_NUMBERS: tuple[Column[Any], ...] = (*EDGES, *STREAMS)
_MEANINGS = {
    **{each.heading: each.meaning for each in _NUMBERS if each.meaning},
    "lost": "ticks of timers and messages that a slow callback made a node lose",
}
_COLUMNS = "\n".join(f"  {heading:<10}{meaning}" for heading, meaning in _MEANINGS.items())

_HELP = f"""\
Keys
  1 2 3 4   the tabs: frames, streams, nodes, topics and services
  s r       sort by the next column; reverse (or click a heading)
  /         show only rows with these words; Escape shows all
  Enter     a frame's rate and delay over two minutes, and all facts
  m         measure the Hz of the topic under the cursor, or stop
  Space     pause; q or Ctrl-C quits

Columns
{_COLUMNS}

States
  stale: silent for longer than its rate allows; gone: its publisher has
  left the bus; conflict: two live streams publish it; ahead: its newest
  stamp is in the future\
"""


class HelpScreen(ModalScreen[None]):
    """The meaning of keys, columns and states."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark", "dismiss", "Back"),
    ]
    CSS = """
    HelpScreen { align: center middle; }
    HelpScreen VerticalScroll {
        width: 76; height: auto; max-height: 90%; border: round $accent; padding: 0 1;
    }
    HelpScreen Static { height: auto; }
    """

    def compose(self) -> ComposeResult:
        with VerticalScroll():
            yield Static(Text(_HELP))
        yield Footer()


class TopApp(App[None]):
    """All tables, one per tab."""

    TITLE = "tfbus top"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    TabbedContent { height: 1fr; }
    DataTable { height: 1fr; }
    #filter { display: none; height: 3; }
    #head { height: auto; max-height: 3; color: $text-muted; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark", "help", "Help", key_display="?"),
        Binding("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", show=False, priority=True),
        # The tabs themselves say these.
        Binding("1", "show('frames')", "Frames", show=False),
        Binding("2", "show('streams')", "Streams", show=False),
        Binding("3", "show('nodes')", "Nodes", show=False),
        Binding("4", "show('topics')", "Topics", show=False),
        Binding("s", "sort", "Sort"),
        Binding("r", "reverse", "Reverse"),
        Binding("slash", "filter", "Filter", key_display="/"),
        Binding("space", "pause", "Pause"),
        Binding("m", "measure", "Measure"),
        Binding("escape", "clear", "Clear", show=False),
    ]

    def __init__(self, source: TopSource, signals: StopSignals):
        super().__init__()
        self._source = source
        self._signals = signals
        self._tables: dict[str, ScreenTable] = {}
        self._column = dict.fromkeys(_NAMES, 0)
        self._descending = dict.fromkeys(_NAMES, False)
        # The numbers of the columns that the screen is wide enough for.
        self._columns: dict[str, list[int]] = {}
        self._words = ""
        self._is_paused = False

    def compose(self) -> ComposeResult:
        yield Static("", id="head")
        with TabbedContent(initial="frames"):
            for number, name in enumerate(_NAMES, start=1):
                with TabPane(f"{number} {name.capitalize()}", id=name):
                    yield DataTable(id=f"{name}-table", cursor_type="row", zebra_stripes=True)
        yield Input(placeholder="words that a row must contain", id="filter")
        yield Footer()

    def on_mount(self) -> None:
        asyncio.get_running_loop().add_reader(self._signals.readable, self._end)
        self._update_tables()
        self._find_hint()
        self.set_interval(_LOOK_EVERY_S, self._update_tables)
        self.set_interval(_HINT_EVERY_S, self._find_hint)
        self.set_focus(self._table_of("frames"))

    def _end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._signals.readable)
        self.exit()

    # Keys

    def action_show(self, name: str) -> None:
        """Show a tab."""
        self.query_one(TabbedContent).active = name
        self.set_focus(self._table_of(name))

    def action_help(self) -> None:
        """Show the meaning of keys and columns."""
        if not isinstance(self.screen, HelpScreen):
            self.push_screen(HelpScreen())

    def action_measure(self) -> None:
        """Measure the rate of the topic under the cursor, or stop that."""
        table = self._table_of("topics")
        if self._tab() == "topics" and table.row_count:
            row = table.ordered_rows[table.cursor_row]
            kind, _, topic = str(row.key.value).partition(" ")
            if kind == "topic":
                self._source.measure(topic)
                self._update_tables()

    def action_sort(self) -> None:
        """Sort by the next column."""
        name = self._tab()
        columns = self._columns[name]
        later = [at for at in columns if at > self._column[name]]
        self._column[name] = (later or columns)[0]
        self._show(name)

    def action_reverse(self) -> None:
        """Reverse the order."""
        name = self._tab()
        self._descending[name] = not self._descending[name]
        self._show(name)

    def action_filter(self) -> None:
        """Show the field for words."""
        field = self.query_one("#filter", Input)
        field.display = True
        self.set_focus(field)

    def action_clear(self) -> None:
        """Show all rows again."""
        field = self.query_one("#filter", Input)
        field.value = ""
        field.display = False
        self.set_focus(self._table_of(self._tab()))

    def action_pause(self) -> None:
        """Pause, or go on."""
        self._is_paused = not self._is_paused
        self._say()

    def on_input_changed(self, event: Input.Changed) -> None:
        self._words = event.value
        for name in _NAMES:
            self._show(name)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.set_focus(self._table_of(self._tab()))

    def on_data_table_header_selected(self, event: DataTable.HeaderSelected) -> None:
        name = self._tab()
        column = self._columns[name][event.column_index]
        if self._column[name] == column:
            self._descending[name] = not self._descending[name]
        self._column[name] = column
        self._show(name)

    def on_resize(self) -> None:
        for name in self._tables:
            self._show(name)

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        is_open = isinstance(self.screen, FrameScreen)
        if self._tab() == "frames" and event.row_key.value is not None and not is_open:
            self.push_screen(FrameScreen(self._source, event.row_key.value))

    # Tables

    @work(thread=True, exclusive=True)
    def _find_hint(self) -> None:
        self._source.find_hint()

    def _update_tables(self) -> None:
        tables = self._source.tables()
        if not self._is_paused or not self._tables:
            self._tables = tables
            for name in _NAMES:
                self._show(name)
            self._say()

    def _show(self, name: str) -> None:
        if name not in self._tables:
            return
        table, shown = self._tables[name], self._table_of(name)
        column, descending = self._column[name], self._descending[name]
        rows = chosen(table, self._words, column, descending)[:_MOST_ROWS]
        marks = [
            (" ▼" if descending else " ▲") if at == column else ""
            for at in range(len(table.headings))
        ]
        width = shown.scrollable_content_region.width or self.size.width
        former = self._columns.get(name, range(len(table.headings)))
        columns = fitting(table, rows, width, former)
        self._columns[name] = columns
        headings = [table.headings[at] + marks[at] for at in columns]
        if [str(each.label) for each in shown.ordered_columns] != headings:
            shown.clear(columns=True)
            for heading in headings:
                shown.add_column(heading)
        _fill(shown, rows, columns)

    def _say(self) -> None:
        count = {name: len(table.rows) for name, table in self._tables.items()}
        services = sum(is_service(row) for row in self._tables["topics"].rows)
        count["topics"] -= services
        words = [counted(count[name], name.removesuffix("s")) for name in _NAMES]
        words.append(counted(services, "service"))
        gone = sum(row.state == "gone" for row in self._tables["frames"].rows)
        words += [f"{gone} gone"] * bool(gone) + ["paused"] * self._is_paused
        if max(count.values()) > _MOST_ROWS:
            words.append(f"{_MOST_ROWS} rows are shown, filter (/) for others")
        hint = self._source.hint if not count["frames"] else ""
        text = f"tfbus top: {', '.join(words)}{hint and f'; {hint}'}"
        self.query_one("#head", Static).update(Text(text))

    def _tab(self) -> str:
        return self.query_one(TabbedContent).active

    def _table_of(self, name: str) -> "DataTable[Text]":
        table: DataTable[Text] = self.query_one(f"#{name}-table", DataTable)
        return table


def _cells(row: Row, columns: list[int]) -> list[Text]:
    style = _STYLES.get(row.state, "")
    return [
        Text(cell.text, style=style, justify="left" if isinstance(cell.value, str) else "right")
        for cell in (row.cells[at] for at in columns)
    ]


def _fill(table: "DataTable[Text]", rows: list[Row], columns: list[int]) -> None:
    """Show these rows with these columns; the cursor stays on its row, or at its place."""
    keys = [str(row.key.value) for row in table.ordered_rows]
    at = table.cursor_row
    if keys == [row.key for row in rows]:
        # In place, as clearing a table flickers.
        for number, row in enumerate(rows):
            for column, cell in enumerate(_cells(row, columns)):
                table.update_cell_at(Coordinate(number, column), cell, update_width=True)
        return
    table.clear()
    for row in rows:
        table.add_row(*_cells(row, columns), key=row.key)
    under = keys[at] if at < len(keys) else ""
    found = [number for number, row in enumerate(rows) if row.key == under]
    table.move_cursor(row=found[0] if found else min(at, max(len(rows) - 1, 0)))


def show(source: TopSource) -> None:
    """Show the screen until the user leaves it, or a signal comes.

    A KeyboardInterrupt in the midst of Textual would leave its threads running, and the terminal
    as it is: the screen ends as by its key.
    """
    with held_signals() as signals:
        TopApp(source, signals).run()
