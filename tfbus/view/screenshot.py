"""A picture of the page, taken by a headless Chromium.

It is driven over its DevTools protocol, with the websocket library that viser brings.
"""

import base64
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from tfbus.base.errors import TfbusError
from tfbus.base.whole_file import replacing

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")

# SwiftShader draws WebGL without a graphics card, but only on request.
FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-dev-shm-usage",
)

# How long the browser may take to start, and the page to appear.
_PATIENCE_S = 60.0

# Without a graphics card movements are shown late, and not all of them equally late.
_SETTLE_S = 2.0

# How long to wait for the thread when its browser is gone.
_END_S = 1.0

_IS_THERE = "!!document.querySelector('canvas') && !!document.querySelector('[role=status]')"
# viser notes that WebGL is slow without a graphics card; the note would cover the picture.
CLOSE_NOTES = (
    "document.querySelectorAll('.mantine-Notification-closeButton')"
    ".forEach(button => button.click())"
)
# Open a tab by its title, as its key does; show the first image in it, which controls are above.
# Those of viser's own buttons are drawings.
PICTURES = "img[src^='data:image/jpeg'], img[src^='blob:']"
OPEN_TAB = (
    "[...document.querySelectorAll('[role=tab]')].find(tab => tab.textContent.trim() === {})"
    "?.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Enter', bubbles: true}}))"
)
SHOW_PICTURE = (
    f'[...document.querySelectorAll("{PICTURES}")]'
    ".find(image => image.offsetParent)?.scrollIntoView({block: 'end'})"
)


class BrowserError(TfbusError):
    """There is no browser, or it took no picture; the message says why."""


def find_browser() -> str:
    """The path of the installed Chromium. Raises BrowserError if there is none."""
    for name in _BROWSERS:
        if path := shutil.which(name):
            return path
    raise BrowserError(
        "no Chromium to take the picture: apt-get install chromium, or have one on PATH as "
        f"{', '.join(_BROWSERS)}"
    )


class Screenshot:
    """A picture, taken `after_s` seconds after the page appears; `size` in pixels."""

    def __init__(self, path: Path, after_s: float, size: tuple[int, int], browser: str) -> None:
        self._path = path
        self._after_s = after_s
        self._size = size
        self._browser = browser
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        self._was_early = False
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._process: subprocess.Popen[str] | None = None

    def begin(self, address: str, hold: Callable[[], str], on_end: Callable[[], object]) -> None:
        """Take it on a thread of its own, then call `on_end()`.

        Calls `hold()` first, which must stop all changes of the page, and returns the title of the
        tab to open, "" for none.
        """

        def take() -> None:
            try:
                picture = self._take(address, hold)
                with replacing(self._path) as file:
                    file.write(picture)
            except Exception as error:  # `finish` raises it
                self._error = error
            finally:
                self._ended.set()
                on_end()

        self._thread = threading.Thread(target=take, name="screenshot", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the browser, whether or not there is a picture. Twice is fine."""
        self._was_early = self._was_early or not self._ended.is_set()
        self._stopped.set()
        self._end_browser()
        if self._thread:
            self._thread.join(_END_S)

    def finish(self) -> None:
        """Stop. Raises KeyboardInterrupt if that was before the picture was taken, and BrowserError
        if none could be taken.
        """
        self.stop()
        if self._was_early:
            raise KeyboardInterrupt
        if self._error:
            raise BrowserError(f"no picture was taken: {self._error}") from self._error

    def _take(self, address: str, hold: Callable[[], str]) -> bytes:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            browser = self._start_browser(address, profile)
            # Of a browser that says nothing, reading would never end.
            is_late = threading.Timer(_PATIENCE_S, self._end_browser)
            is_late.daemon = True
            is_late.start()
            try:
                debugger = devtools_of(browser)
                is_late.cancel()
                return self._picture(debugger, hold)
            finally:
                is_late.cancel()
                self._end_browser()

    def _start_browser(self, address: str, profile: str) -> "subprocess.Popen[str]":
        # Chromium's sandbox refuses to work for root, as in most containers.
        root = ["--no-sandbox"] if os.geteuid() == 0 else []
        with self._lock:
            if self._stopped.is_set():
                raise BrowserError("stopped before the browser was started")
            self._process = subprocess.Popen(
                [
                    *(self._browser, *FLAGS, *root),
                    "--remote-debugging-port=0",
                    f"--user-data-dir={profile}",
                    f"--window-size={self._size[0]},{self._size[1]}",
                    address,
                ],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                # A group of its own: it ends with all its children, and not by our Ctrl-C.
                start_new_session=True,
            )
            return self._process

    def _end_browser(self) -> None:
        """End the browser and all its children."""
        with self._lock:
            process = self._process
            if process and process.returncode is None:
                # Not yet waited for, so no other group can have its number.
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def _picture(self, debugger: str, hold: Callable[[], str]) -> bytes:
        with connect(_page_of(debugger), max_size=None) as socket:
            numbers = itertools.count(1)

            def ask(method: str, **parameters: Any) -> Any:
                number = next(numbers)
                socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
                while True:
                    answer = json.loads(socket.recv(_PATIENCE_S))
                    if answer.get("id") == number:
                        break
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error'].get('message')}")
                return answer["result"]

            width, height = self._size
            ask(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=height,
                deviceScaleFactor=1,
                mobile=False,
            )
            deadline_s = time.monotonic() + _PATIENCE_S
            while not ask("Runtime.evaluate", expression=_IS_THERE)["result"].get("value"):
                if time.monotonic() > deadline_s:
                    raise BrowserError(f"the page did not appear after {_PATIENCE_S:g} s")
                time.sleep(0.1)
            self._stopped.wait(self._after_s)
            ask("Runtime.evaluate", expression=CLOSE_NOTES)
            tab = hold()
            if tab:
                ask("Runtime.evaluate", expression=OPEN_TAB.format(json.dumps(tab)))
            self._stopped.wait(_SETTLE_S)
            if tab:
                ask("Runtime.evaluate", expression=SHOW_PICTURE)
            return base64.b64decode(ask("Page.captureScreenshot", format="png")["data"])


def devtools_of(browser: "subprocess.Popen[str]") -> str:
    """Host and port of the DevTools of a starting Chromium. Raises BrowserError if it ends."""
    assert browser.stderr is not None
    said = []
    for line in browser.stderr:
        if found := re.search(r"DevTools listening on ws://([^/]+)/", line):
            # It keeps writing, and would block if nothing read it.
            threading.Thread(target=browser.stderr.read, daemon=True).start()
            return found[1]
        said.append(line.strip())
    raise BrowserError(
        f"Chromium ended, or did not start within {_PATIENCE_S:g} s: {' '.join(said)[-300:]}"
    )


def _page_of(debugger: str) -> str:
    """The address of the one page that is open."""
    with urllib.request.urlopen(f"http://{debugger}/json/list", timeout=_PATIENCE_S) as answer:
        pages = [page for page in json.load(answer) if page["type"] == "page"]
    if not pages:
        raise BrowserError("Chromium opened no page")
    return str(pages[0]["webSocketDebuggerUrl"])
