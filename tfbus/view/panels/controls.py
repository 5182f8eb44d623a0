"""Controls on the panel: a dropdown of frames, the buttons of the camera, and the settings."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Protocol

import viser

from tfbus.base.errors import SettingsError
from tfbus.base.wording import printable
from tfbus.view.frames import Frames
from tfbus.view.panels.markup import Html
from tfbus.view.settings import (
    RANGES,
    NameFilter,
    PatternError,
    Selections,
    ViewSettings,
    ViewState,
    read_settings,
    save_settings,
    written_settings,
)

# A longer list is slow in a browser; the filter narrows it.
MOST = 300


class Control:
    """A control of viser's for a value that browsers and the program change.

    `on_choice(value)` is called with each value that a browser sets, on viser's event loop: in
    their order, and it must not wait.
    """

    # The value and options of viser's handles can be set, which mypy does not see.
    def __init__(self, handle: Any, on_choice: Callable[[Any], object]) -> None:
        self._handle = handle
        self._shown = self._value

        # Not on a thread of viser's pool, which may come to it after the next value is there.
        async def on_update(event: Any) -> None:
            # A change by the program has no client.
            if event.client is not None:
                value = self._value
                on_choice(value)
                self._shown = value

        handle.on_update(on_update)

    def show(self, value: Any) -> None:
        """Show the value that holds in the program.

        While that is the one shown last, a browser's later choice stays: it is on its way.
        """
        if value == self._shown:
            return
        self._shown = value
        if self._value != value:
            self._value = value

    @property
    def _value(self) -> Any:
        return self._handle.value

    @_value.setter
    def _value(self, value: Any) -> None:
        self._handle.value = value


class FrameDropdown(Control):
    """A choice of one frame; the first entry, `nothing`, stands for none, "" in the program."""

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        nothing: str,
        on_choice: Callable[[str], object],
        hint: str | None = None,
    ) -> None:
        self._nothing = self._label = nothing
        self._listed: Sequence[str] = ()
        super().__init__(gui.add_dropdown(label, (nothing,), hint=hint), on_choice)

    @property
    def order(self) -> float:
        """Its place in the tab: higher ones are below."""
        return float(self._handle.order)

    def offer(self, names: Sequence[str], chosen: str, nothing: str | None = None) -> None:
        """Offer these frames, and show the chosen one; `nothing` renames the first entry."""
        if nothing is not None:
            self._nothing = nothing
        self._listed = [*dict.fromkeys(names[:MOST])]
        if chosen and chosen not in self._listed:
            self._listed = [chosen, *self._listed]
        former, self._label = self._label, self._nothing
        while self._label in self._listed:  # a frame may have any name, and browsers take no two
            self._label = f"({self._label})"
        options = (self._label, *self._listed)
        if self._handle.options != options:
            is_nothing = self._handle.value == former != self._label
            self._handle.options = options
            if is_nothing:
                self._handle.value = self._label
        self.show(chosen)

    @property
    def _value(self) -> str:
        # The first entry may have been renamed since a browser chose it.
        label = self._handle.value
        return label if label in self._listed else ""

    @_value.setter
    def _value(self, name: str) -> None:
        self._handle.value = name or self._label


_NOTE_S = 4.0


class MovesCameras(Protocol):
    """The page, which moves the camera of one browser, by the number of the client."""

    def show_all(self, client: int) -> None:
        """Let the browser see all that is drawn."""

    def show_from_above(self, client: int) -> None:
        """Let it see the same from straight above."""

    def focus(self, client: int) -> str:
        """Let it see the frame that is selected there; why it cannot, "" if it can."""


def add_camera_commands(gui: viser.GuiApi, page: MovesCameras) -> None:
    """Add buttons and keys that move the camera of the browser in which they are used: H shows all,
    T from above, F the selected frame; a note of 4 s says why it cannot.
    """

    def on_all(event: Any) -> None:
        if event.client is not None:
            page.show_all(event.client.client_id)

    def on_top(event: Any) -> None:
        if event.client is not None:
            page.show_from_above(event.client.client_id)

    def on_focus(event: Any) -> None:
        if event.client is None or not (why := page.focus(event.client.client_id)):
            return
        event.client.add_notification("Nothing to look at", why, auto_close_seconds=_NOTE_S)

    def on_click(event: Any) -> None:
        {_ALL: on_all, _TOP: on_top, _SELECTED: on_focus}[buttons.value](event)

    buttons = gui.add_button_group(
        "Look at",
        (_ALL, _TOP, _SELECTED),
        hint="Moves only your camera. Keys: H all, T all from above, F the selected.",
    )
    buttons.on_click(on_click)
    gui.add_command("Look at all frames", hotkey="H").on_trigger(on_all)
    gui.add_command("Look at all frames from above", hotkey="T").on_trigger(on_top)
    gui.add_command("Look at the selected frame", hotkey="F").on_trigger(on_focus)


_ALL = "All (H)"
_TOP = "Top (T)"
_SELECTED = "Selected (F)"


_BOXES = {
    "follow_yaw": "Turn with it",
    "axes": "Axes",
    "names": "Names",
    "arrows": "Arrows",
    "grid": "Grid",
    "dark": "Dark",
}
_SLIDERS = {"scale": ("Scale", 0.1), "opacity": ("Opacity", 0.05), "trail_s": ("Trail (s)", 0.5)}
_PATTERNS = {
    "only": ("Only", "A regular expression: shows only frames whose names match it."),
    "never": ("Never", "A regular expression: hides frames whose names match it."),
}

_READ_ONLY = (
    '<div class="tf tf-dim">This page is read-only: it moves nothing and saves nothing. What is '
    "chosen here, all browsers see.</div>"
)

_DOWNLOAD = "A file of these settings for your machine."
_UPLOAD = "A file of settings of your machine replaces these, for all browsers."
_MOST_BYTES = 1_000_000


class DisplayPanel:
    """Controls of the settings; the save button writes them to `path`. Without one it is not there,
    nor are the buttons for files of the browser's machine.
    """

    def __init__(
        self, gui: viser.GuiApi, view: ViewState, selections: Selections, path: Path | None
    ) -> None:
        self._gui = gui
        self._view = view
        self._selections = selections
        self._is_dark: bool | None = None
        self._controls: dict[str, Control] = {}
        settings = view.settings
        self._follow = FrameDropdown(
            gui,
            "Camera follows",
            "nothing",
            lambda name: view.change(follow=name),
            hint="This frame stays where it is in the picture, and the rest moves.",
        )
        for name, label in _BOXES.items():
            self._bind(name, gui.add_checkbox(label, getattr(settings, name)))
        for name, (label, step) in _SLIDERS.items():
            least, most = RANGES[name]
            self._bind(name, gui.add_slider(label, least, most, step, getattr(settings, name)))
        self._patterns: dict[str, Any] = {}
        for name, (label, hint) in _PATTERNS.items():
            handle = gui.add_text(label, getattr(settings, name), hint=hint)
            Control(handle, partial(self._filter, name))
            self._patterns[name] = handle
        self._mistake = Html(gui.add_html(""))
        if path is None:
            gui.add_html(_READ_ONLY)
            return
        save_button = gui.add_button("Save settings", icon=viser.Icon.DEVICE_FLOPPY)
        save_button.on_click(lambda event: self._save(event, path))
        fetch = gui.add_button("Download settings", icon=viser.Icon.DOWNLOAD, hint=_DOWNLOAD)
        fetch.on_click(lambda event: self._download(event, path.name))
        load = gui.add_upload_button(
            "Load settings", icon=viser.Icon.UPLOAD, mime_type=".yaml,.yml", hint=_UPLOAD
        )
        load.on_upload(lambda event: self._load(event.target.value))
        self._saved = Html(gui.add_html(""))

    def refresh(self, frames: Frames) -> None:
        """Follow settings that another control has changed, and offer the frames."""
        settings = self._view.settings
        self._follow.offer(sorted(frames.by_name), settings.follow)
        for name, control in self._controls.items():
            control.show(getattr(settings, name))
        if settings.dark != self._is_dark:
            self._is_dark = settings.dark
            self._gui.configure_theme(
                dark_mode=settings.dark, show_logo=False, show_share_button=False
            )

    def _bind(self, name: str, handle: Any) -> None:
        self._controls[name] = Control(handle, lambda value: self._view.change(**{name: value}))

    def _filter(self, name: str, pattern: str) -> None:
        try:
            NameFilter(pattern)
        except PatternError:
            pass  # _mistakes says so, for both fields together
        else:
            self._view.change(**{name: pattern})
        self._mistake.show(self._mistakes())

    def _mistakes(self) -> str:
        found = []
        for name, handle in self._patterns.items():
            try:
                NameFilter(handle.value)
            except PatternError as error:
                found.append(
                    f'<div class="tf tf-alarm" role="alert">{_PATTERNS[name][0]}: '
                    f"{escape(str(error))}. The previous filter stays in effect.</div>"
                )
        return "".join(found)

    def _chosen(self, event: Any) -> ViewSettings:
        """The settings, with the frame that is selected in the browser of an event."""
        return replace(self._view.settings, selected=self._selections.of(event.client_id))

    def _save(self, event: Any, path: Path) -> None:
        try:
            save_settings(self._chosen(event), path)
        except SettingsError as error:
            self._tell_mistake(error)
        else:
            again = f"tfbus view --settings {shlex.quote(str(path))}"
            self._saved.show(
                f'<div class="tf tf-dim">Saved. Open it with <code>{escape(again)}</code></div>'
            )

    def _download(self, event: Any, name: str) -> None:
        if event.client is not None:
            content = written_settings(self._chosen(event))
            event.client.send_file_download(name, content, save_immediately=True)

    def _load(self, file: viser.UploadedFile) -> None:
        name = printable(file.name, 60)
        try:
            if len(file.content) > _MOST_BYTES:
                raise SettingsError(f"{name} is too large for a file of settings")
            settings = read_settings(file.content.decode(), name)
        except UnicodeDecodeError:
            self._tell_mistake(SettingsError(f"{name} is no text"))
        except SettingsError as error:
            self._tell_mistake(error)
        else:
            self._view.load(settings)
            for pattern, handle in self._patterns.items():
                handle.value = getattr(settings, pattern)
            self._mistake.show("")
            self._saved.show(f'<div class="tf tf-dim">Loaded {escape(name)}.</div>')

    def _tell_mistake(self, error: SettingsError) -> None:
        text = escape(printable(str(error), 500))
        self._saved.show(f'<div class="tf tf-alarm" role="alert">{text}</div>')
