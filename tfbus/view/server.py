"""The server of the page, made with viser: where it listens, who may use it, and its theme."""

import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import rich
import viser

from tfbus.errors import TfbusError
from tfbus.view.origin import Guard, guarding


class ServeError(TfbusError):
    """The page cannot be served; the message says why."""


def serve(
    host: str, port: int, title: str = "tfbus", guard: Guard | None = None
) -> viser.ViserServer:
    """A server of viser; it takes the next free port from this one on, and has a title.

    The guard, of the same host, checks its requests.

    Raises ServeError if it cannot listen, or would accept any web page.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        # viser would report a failure on another thread, and go on.
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except OSError as error:
        raise ServeError(
            f"cannot listen on {host!r}: {error.strerror or error}; 127.0.0.1 is this machine alone"
        ) from error
    # Browsers open connections in advance and close them again: not worth a log line.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    guard = guard or Guard(host)
    with guarding(guard), silent_viser():
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if not guard.stands:
        server.stop()
        raise ServeError(
            f"viser {viser.__version__} starts its server in a way that tfbus does not know: any "
            "web page could use it; install a known one: pip install 'viser==1.1.*'"
        )
    # Any browser could ask viser to pass the page on through a server of its makers.
    server.request_share_url = _unshared  # type: ignore[method-assign]
    server.scene.set_up_direction("+z")
    # Shadows and reflections say nothing about frames, and without a graphics card take most of
    # the time.
    server.scene.configure_default_lights(enabled=False, cast_shadow=False)
    server.scene.configure_environment_map(None)
    _light(server.scene)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # Beside the scene instead of over it; in a narrow window it is below anyway.
    server.gui.main_panel.dock_right()
    return server


@contextmanager
def silent_viser() -> Iterator[None]:
    """Inside the `with` viser does not say that it starts or stops, in a notebook neither."""
    console = rich.get_console()
    was_quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = was_quiet


def _unshared(verbose: bool = True) -> None:
    """No address at which all the world could open the page."""


def _light(scene: viser.SceneApi) -> None:
    """Light from all sides, most from the front and above: white robots keep their edges, and black
    ones are not lost in the dark.
    """
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(165, 165, 170), intensity=2.2
    )
    for name, position, intensity in (
        ("key", (2.0, 1.0, 3.0), 1.7),
        ("fill", (-2.0, -1.5, 1.0), 0.6),
        ("side", (1.0, -3.0, 0.5), 0.3),
    ):
        scene.add_light_directional(
            f"/light/{name}", intensity=intensity, position=position, cast_shadow=False
        )
