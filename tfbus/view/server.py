"""The server of the page, as viser makes it: where it listens, for whom, and how it looks."""

import contextlib
import io
import logging
import socket

import viser

from tfbus import TfbusError
from tfbus.view.origin import guarding


class ServeError(TfbusError):
    """The page cannot be served; the message says why."""


def serve(host: str, port: int) -> viser.ViserServer:
    """A server of viser, which takes the next port where this one is taken.

    Raises ServeError where it cannot listen, or would let in everybody.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        # viser would tell of this in another thread, and go on.
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except OSError as error:
        raise ServeError(
            f"cannot listen on {host!r}: {error.strerror or error}; 127.0.0.1 is this machine alone"
        ) from error
    # Browsers open connections to have them ready, and close them: no news.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    with guarding(host) as guard, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="tfbus view", verbose=False)
    if not guard.stands:
        server.stop()
        raise ServeError(
            f"viser {viser.__version__} starts its server in a way that tfbus does not know, and "
            "any web page could speak to it; pip install 'viser==1.1.*' brings one that it does"
        )
    server.scene.set_up_direction("+z")
    # Shadows and mirrored surroundings say nothing of frames, and take most of the time where
    # there is no graphics card.
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_ambient("/light", intensity=1.0)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # Beside the scene, of which it would hide a part; a narrow window has it below anyway.
    server.gui.main_panel.dock_right()
    return server
