"""The parts of the page that are our own HTML, and the way back from them to Python.

Whatever comes from the bus goes through `escape`: a frame may have any name.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from html import escape
from typing import Any, Protocol

import viser

from tfbus.base.bounded import Bounded
from tfbus.base.wording import stamp_text
from tfbus.frames.moment import State

# One sign per state; their shapes alone distinguish them.
_SIGNS: dict[State, str] = {
    "dynamic": "●",
    "static": "■",
    "stale": "◐",
    "ahead": "▶",
    "gone": "✖",
    "conflict": "▲",
    "root": "○",
}


class HtmlHandle(Protocol):
    """An HTML element of viser."""

    content: str


class Html:
    """An HTML element that is sent to the browsers only when it changes."""

    def __init__(self, handle: HtmlHandle) -> None:
        self._handle = handle
        self._content = handle.content

    def show(self, content: str) -> None:
        """Show this HTML."""
        if content != self._content:
            self._content = content
            self._handle.content = content


@contextmanager
def unless_it_left(server: viser.ViserServer, client: int) -> Iterator[None]:
    """Ignores viser's error for elements of a browser that leaves at this moment."""
    try:
        yield
    except RuntimeError:
        if client in server.get_clients():
            raise


# Pages whose events are told apart.
_MOST_PAGES = 1000


class Channel:
    """Carries events from our HTML to Python: `tfbus({do: 'show', frame: 'base'})`.

    viser has no custom messages, so events are typed into a hidden text field of viser's: the
    one right after the element with the class tfbus-channel.
    """

    # viser sends a change of a field after 50 ms, and forgets it if any other field of the panel
    # has changed by then: each event is typed three times, farther apart than that.
    SCRIPT = """
if (!window.tfbus) {
  const page = Math.random().toString(36).slice(2);
  let waiting = [], count = 0, typed = 0, timer = null;
  const type = () => {
    timer = waiting.length ? setTimeout(type, 70) : null;
    const field = document.querySelector('div:has(> .tfbus-channel) + div input');
    if (!waiting.length || !field) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
    // A field that stays as it is has no update.
    typed += 1;
    set.call(field, JSON.stringify({page, typed, events: waiting.map(({event}) => event)}));
    field.dispatchEvent(new Event('input', {bubbles: true}));
    waiting.forEach((each) => { each.times += 1; });
    waiting = waiting.filter((each) => each.times < 3);
  };
  window.tfbus = (event) => {
    waiting = [...waiting, {event: {...event, n: ++count}, times: 0}].slice(-100);
    if (timer === null) type();
  };
}
window.tfbusCopy = (id) => {
  const element = document.getElementById(id);
  getSelection().selectAllChildren(element);
  if (navigator.clipboard) navigator.clipboard.writeText(element.innerText);
};
"""

    def __init__(self) -> None:
        self._handlers: dict[str, Callable[[Mapping[str, Any]], object]] = {}
        # The number of the last event of each page.
        self._last: Bounded[str, int] = Bounded(_MOST_PAGES)

    def on(self, do: str, handler: Callable[[Mapping[str, Any]], object]) -> None:
        """Call `handler(event)` for each event of this kind, in the order in which a browser sends
        them, on viser's event loop: it must not wait.
        """
        self._handlers[do] = handler

    def listen(self, field: Any) -> None:
        """Take the events that are typed into this field of viser's."""

        # All browsers share the field: on a thread of viser's pool it may hold the next event.
        async def on_update(event: Any) -> None:
            self.read(field.value, event.client_id)

        field.on_update(on_update)

    def read(self, text: str, client: int | None = None) -> None:
        """Take the events that a client typed, each once; ignores other text."""
        try:
            typed = json.loads(text)
            page, events = str(typed["page"])[:40], list(typed["events"])
            numbered = [(int(event["n"]), event) for event in events]
        except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
            return
        for number, event in numbered:
            if number > self._last.get(page, 0):
                self._last[page] = number
                self.receive(event, client)

    def receive(self, event: Mapping[str, Any], client: int | None = None) -> None:
        """Take an event of a client, whose number the handler finds as `event["client"]`."""
        if handler := self._handlers.get(str(event.get("do"))):
            handler({**event, "client": client})

    def html(self, style: str = "", script: str = "", title: str = "tfbus") -> str:
        """The element before the text field, with the page's style, script and title."""
        # A script element in HTML that is set later does not run; the handler of an error does.
        whole = f"document.title = {json.dumps(title)};{self.SCRIPT}{script}"
        run = f'<img hidden alt="" src="data:," onerror="{escape(whole)}">'
        return f'<div class="tfbus-channel"><style>{STYLE}{style}</style>{run}</div>'


def sign(state: State) -> str:
    """The sign of a state, in its colour."""
    return f'<span class="tf-sign tf-{state}">{_SIGNS[state]}</span>'


def event(do: str, **values: str) -> str:
    """JavaScript, for an attribute, that sends an event; values are JavaScript expressions."""
    inside = ", ".join([f"do: '{do}'", *(f"{name}: {value}" for name, value in values.items())])
    return escape(f"tfbus({{{inside}}})")


# Stamps before 1980 are not dates: simulated time begins at 0. Stamps after 9999 have none.
FIRST_DATE_NS = 315_532_800 * 1_000_000_000
_MOST_DATE_S = 253_402_000_000


def clock_time(stamp_ns: int, now_ns: int) -> str:
    """A stamp as a local time, with the date if that is another day than now; as HTML.

    Simulated time, which begins at 0, stays in seconds. A tooltip has the whole stamp.
    """
    if stamp_ns < FIRST_DATE_NS:
        text = f"{stamp_ns / 1e9:.3f} s"
    else:
        # In whole milliseconds, cut, as clocks show them.
        at, now = (_local(ns) for ns in (stamp_ns, now_ns))
        day = "" if at.date() == now.date() else f"{at:%Y-%m-%d} "
        text = f"{day}{at:%H:%M:%S}.{stamp_ns // 1_000_000 % 1000:03}"
    return f'<span class="tf-note-whole" title="{stamp_text(stamp_ns)}">{text}</span>'


def _local(stamp_ns: int) -> datetime:
    """The local time, to the second; the last that a datetime can hold for later stamps."""
    seconds = min(stamp_ns // 1_000_000_000, _MOST_DATE_S)
    return datetime.fromtimestamp(seconds, UTC).astimezone()


STYLE = """
div:has(> .tfbus-channel) { height: 0; }
div:has(> .tfbus-channel) + div { display: none; }
.mantine-ScrollArea-root:has(.tfbus-channel) { --scrollarea-scrollbar-size: 8px; }
.mantine-ScrollArea-content:has(.tfbus-channel) > div { padding-right: 8px; }
[role=tablist] { flex-wrap: nowrap !important; }
[role=tab] { flex: 1 0 auto; justify-content: center; padding: 0 0.3em !important; }
.tf { font-size: 0.8125rem; line-height: 1.45; padding: 0 0.75em 0.5em; overflow-wrap: anywhere;
  color: var(--mantine-color-text); }
.tf-dim { color: var(--mantine-color-dimmed); }
.tf-alarm { color: light-dark(#b3261e, #ff8a80); }
.tf-row { display: flex; align-items: center; gap: 0.4em; min-height: 1.6em; border-radius: 4px; }
.tf-row:hover { background: light-dark(#0000000d, #ffffff14); }
.tf-row.tf-selected { background: light-dark(#228be626, #228be64d); }
.tf-row input { margin: 0; accent-color: #228be6; flex: none; cursor: pointer; }
.tf-row button { all: unset; cursor: pointer; flex: 1; min-width: 0; overflow: hidden;
  text-overflow: ellipsis; white-space: nowrap; }
.tf-row button:focus-visible { outline: 2px solid #228be6; border-radius: 3px; }
div:has(> .tf[role=tree]) { max-height: max(42vh, calc(100vh - 290px)); overflow-y: auto;
  scrollbar-width: thin; }
div:has(> .tf[role=tree] .tf-selected) { max-height: max(42vh, calc(100vh - 610px)); }
.tf-topic { flex: 1; min-width: 0; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.tf-robot-name { margin-top: 0.5em; }
.tf-members { padding-left: 1.2em; margin-bottom: 0.5em; }
div:has(> .tf[role=group]) { max-height: 42vh; overflow-y: auto; scrollbar-width: thin;
  margin-bottom: 0.7em; }
.tf-robot { display: flex; align-items: center; gap: 0.4em; flex: 1; min-width: 0;
  cursor: pointer; overflow-wrap: anywhere; }
.tf-title { display: flex; align-items: center; gap: 0.8em; margin: 0.3em 0; }
.tf-title b { flex: 1; }
.tf-title label { display: flex; align-items: center; gap: 0.3em; cursor: pointer; }
.tf-title input { margin: 0; accent-color: #228be6; }
.tf-note { color: var(--mantine-color-dimmed); font-variant-numeric: tabular-nums;
  white-space: nowrap; }
.tf-note-whole { white-space: nowrap; }
.tf-why { padding: 0 0 0.3em 1.9em; font-size: 0.75rem; }
.tf-sign { flex: none; width: 1em; text-align: center; }
.tf-dynamic { color: light-dark(#2b8a3e, #69db7c); }
.tf-static { color: light-dark(#1864ab, #74c0fc); }
.tf-stale { color: light-dark(#a85f00, #ffc078); }
.tf-ahead { color: light-dark(#0b7285, #66d9e8); }
.tf-gone { color: light-dark(#b3261e, #ff8a80); }
.tf-conflict { color: light-dark(#a61e9c, #f783ff); }
.tf-root { color: var(--mantine-color-dimmed); }
.tf-facts { display: grid; grid-template-columns: max-content 1fr; gap: 0 0.8em; margin: 0; }
.tf-facts dt { color: var(--mantine-color-dimmed); }
.tf-facts dd { margin: 0; }
.tf pre { font-family: ui-monospace, monospace; font-size: 0.72rem; line-height: 1.4; margin: 0;
  white-space: pre-wrap; background: light-dark(#f1f3f5, #00000040); border-radius: 4px;
  padding: 0.4em 0.5em; }
.tf-head { display: flex; justify-content: space-between; margin-top: 0.4em; }
.tf-link { all: unset; cursor: pointer; color: light-dark(#1971c2, #74c0fc); font-size: 0.75rem; }
.tf-link:focus-visible { outline: 2px solid #228be6; }
@media (max-width: 40em) {
  .mantine-Paper-root:has(.tfbus-channel) { width: 100% !important; max-height: 55vh !important; }
  .mantine-ScrollArea-content:has(.tfbus-channel) > div { width: 100% !important; }
}
"""
