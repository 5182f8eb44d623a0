"""How frames are drawn, which of them, and where these choices are saved."""

import shlex
from collections.abc import Callable
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import viser

from tfbus.errors import SettingsError
from tfbus.view.model.settings import RANGES, NameFilter, PatternError, save_settings
from tfbus.view.model.view_state import Selections, ViewState
from tfbus.view.panels.markup import Html

_BOXES = {
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


class DisplayPanel:
    """Controls of the settings; the save button writes them to `path`, and is not there without
    one.
    """

    def __init__(
        self, gui: viser.GuiApi, view: ViewState, selections: Selections, path: Path | None
    ) -> None:
        self._gui = gui
        self._view = view
        self._selections = selections
        self._is_dark: bool | None = None
        self._controls: dict[str, Any] = {}
        settings = view.settings
        for name, label in _BOXES.items():
            self._bind(name, gui.add_checkbox(label, getattr(settings, name)))
        for name, (label, step) in _SLIDERS.items():
            least, most = RANGES[name]
            self._bind(name, gui.add_slider(label, least, most, step, getattr(settings, name)))
        self._patterns: dict[str, Any] = {}
        for name, (label, hint) in _PATTERNS.items():
            handle = gui.add_text(label, getattr(settings, name), hint=hint)
            handle.on_update(self._on_pattern(name, handle))
            self._patterns[name] = handle
        self._mistake = Html(gui.add_html(""))
        if path is None:
            gui.add_html(_READ_ONLY)
            return
        save_button = gui.add_button("Save settings", icon=viser.Icon.DEVICE_FLOPPY)
        save_button.on_click(lambda event: self._save(event, path))
        self._saved = Html(gui.add_html(""))

    def refresh(self) -> None:
        """Follow settings that another control has changed."""
        settings = self._view.settings
        for name, handle in self._controls.items():
            if handle.value != getattr(settings, name):
                handle.value = getattr(settings, name)
        if settings.dark != self._is_dark:
            self._is_dark = settings.dark
            self._gui.configure_theme(
                dark_mode=settings.dark, show_logo=False, show_share_button=False
            )

    def _bind(self, name: str, handle: Any) -> None:
        self._controls[name] = handle
        handle.on_update(lambda event: self._view.change(**{name: handle.value}))

    def _on_pattern(self, name: str, handle: Any) -> Callable[[Any], None]:
        def take(event: Any) -> None:
            try:
                NameFilter(handle.value)
            except PatternError:
                pass  # _mistakes says so, for both fields together
            else:
                self._view.change(**{name: handle.value})
            self._mistake.show(self._mistakes())

        return take

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

    def _save(self, event: Any, path: Path) -> None:
        try:
            selected = self._selections.of(event.client_id)
            save_settings(replace(self._view.settings, selected=selected), path)
        except SettingsError as error:
            self._saved.show(f'<div class="tf tf-alarm" role="alert">{escape(str(error))}</div>')
        else:
            again = f"tfbus view --settings {shlex.quote(str(path))}"
            self._saved.show(
                f'<div class="tf tf-dim">Saved. Open it with <code>{escape(again)}</code></div>'
            )
