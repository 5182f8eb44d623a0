"""The window that shows the turtles' world; needs a display and pygame-ce."""

import io
import os
import sys
from pathlib import Path
from types import ModuleType

from tfbus import TfbusError
from tfbus.base.installation import install_command
from tfbus.base.whole_file import replacing

from . import field
from .world import Snapshot


class DisplayError(TfbusError):
    """The world cannot be shown or its picture saved; the message says why."""


class Window:
    """An open window. Call `show` often, from the main thread, or the desktop takes it for stuck.

    Raises DisplayError without a display or pygame.
    """

    def __init__(self, title: str) -> None:
        self._pygame = _import_pygame()
        from .picture import Picture

        _open_display()
        self._pygame.display.set_caption(title)
        size = (field.SIZE_PX, field.SIZE_PX)
        self._picture = Picture(self._pygame.display.set_mode(size))
        self._shown: Snapshot | None = None
        self.is_open = True

    def __enter__(self) -> "Window":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def show(self, snapshot: Snapshot) -> None:
        """Draw the snapshot if it differs from the last; closes if the user has closed it."""
        if not self.is_open:
            return
        events = {event.type for event in self._pygame.event.get()}
        if self._pygame.QUIT in events:
            self.close()
        elif self._pygame.WINDOWEXPOSED in events or not snapshot.looks_like(self._shown):
            self._shown = snapshot
            self._picture.draw(snapshot)
            self._pygame.display.flip()

    def close(self) -> None:
        """Close the window. Twice is fine."""
        if self.is_open:
            self.is_open = False
            self._pygame.display.quit()


def save_picture(snapshot: Snapshot, path: Path) -> None:
    """Write the picture that a window would show; the file's ending chooses its format.

    Needs no display. Raises DisplayError without pygame, or if the file cannot be written, which
    is as it was then.
    """
    picture = _picture(snapshot, path)
    try:
        with replacing(path) as file:
            file.write(picture)
    except OSError as error:
        raise DisplayError(f"cannot write {path}: {error.strerror}") from error


def check_picture(snapshot: Snapshot, path: Path) -> None:
    """Raise DisplayError if `save_picture` would fail now; writes nothing."""
    _picture(snapshot, path)
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise DisplayError(f"cannot write {path}: no such folder, or no permission")


def _picture(snapshot: Snapshot, path: Path) -> bytes:
    """The bytes of a picture in the format of the path's ending."""
    pygame = _import_pygame()
    from .picture import Picture

    surface = pygame.Surface((field.SIZE_PX, field.SIZE_PX))
    Picture(surface).draw(snapshot)
    content = io.BytesIO()
    try:
        pygame.image.save(surface, content, path.name)
    except (OSError, pygame.error) as error:
        raise DisplayError(f"cannot write {path}: {error}") from error
    return content.getvalue()


def _open_display() -> None:
    import pygame

    asked_for = any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")))
    # Without this check SDL would take over the console of a machine without a desktop.
    if sys.platform.startswith("linux") and not asked_for:
        raise DisplayError("no display; set DISPLAY or WAYLAND_DISPLAY")
    try:
        pygame.display.init()
    except pygame.error as error:
        raise DisplayError(f"cannot use the display: {error}") from error
    # If no display answers, SDL draws into memory.
    if pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in os.environ:
        pygame.display.quit()
        raise DisplayError("the display does not answer; check DISPLAY and WAYLAND_DISPLAY")


def _import_pygame() -> ModuleType:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise DisplayError(f"pygame-ce is not installed: {install_command('sim')}") from error
    return pygame
