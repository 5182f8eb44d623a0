"""The server of the page: viser's, with a guard that chooses the requests to answer.

A page that others can reach needs the token of its `Access`, over an encrypted connection: it is in
the address that is printed, or typed into a form. The browser then gets a cookie made of it,
which no script reads and no other site's page sends, and an address without it.
"""

import atexit
import gzip
import logging
import socket
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, quote

import rich
import viser
from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tfbus.base.addresses import NO_HOST_NAME, own_names
from tfbus.base.errors import TfbusError
from tfbus.command.server_access import AccessToken, PageGate, ServerTls, is_same, machine_names
from tfbus.view.lane import in_lanes

_FORM = """\
<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>tfbus view</title>
<style>body{font:16px sans-serif;margin:4em auto;max-width:24em;padding:0 1em}
input,button{font:inherit;padding:.4em;width:100%;box-sizing:border-box;margin:.3em 0}
@media (prefers-color-scheme:dark){body{background:#1a1b1e;color:#c1c2c5}}</style>
<h1>tfbus view</h1><p>This page needs the token that <code>tfbus view</code> has printed, or was
given.</p><!-- why -->
<form action="/"><input name="token" type="password" autofocus aria-label="token">
<button>Open</button></form>
"""

_WRONG = '<p role="alert"><b>That is not the token.</b></p>'
_TOO_OFTEN = '<p role="alert"><b>Too many wrong tokens: try again in a minute.</b></p>'


@dataclass(frozen=True)
class PageReply:
    """The answer to a request in place of the page that it asks for; `reason` is for a log."""

    status: HTTPStatus
    headers: tuple[tuple[str, str], ...]
    body: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Access:
    """The token of a page, and its end of encrypted connections."""

    token: AccessToken
    tls: ServerTls
    # Cookies know no ports: that of another page on this machine has another name.
    _cookie: str = field(init=False, repr=False)
    _value: str = field(init=False, repr=False)

    def __post_init__(self) -> None:
        name = f"__Host-tfbus-view-{self.token.derived('name of the cookie')[:8]}"
        object.__setattr__(self, "_cookie", name)
        object.__setattr__(self, "_value", self.token.derived("value of the cookie"))

    @property
    def query(self) -> str:
        """The end of the printed address; "" if the token was given, so is known."""
        return f"/?token={quote(self.token.text)}" if self.token.is_new else ""

    def answer(self, path: str, headers: Mapping[str, str], address: str) -> PageReply | None:
        """The answer to a request from an address in place of the page; None with the cookie."""
        if is_same(_cookie_of(headers, self._cookie), self._value):
            return None
        given = parse_qs(path.partition("?")[2]).get("token", [""])[0]
        if not given or headers.get("Upgrade"):
            return PageReply(HTTPStatus.UNAUTHORIZED, _AS_PAGE, _FORM)
        match self.token.judge(given, address):
            case "too often":
                body = _FORM.replace("<!-- why -->", _TOO_OFTEN)
                return PageReply(
                    HTTPStatus.TOO_MANY_REQUESTS, (*_AS_PAGE, ("Retry-After", "60")), body
                )
            case "wrong":
                body = _FORM.replace("<!-- why -->", _WRONG)
                return PageReply(
                    HTTPStatus.UNAUTHORIZED, _AS_PAGE, body, f"a wrong token from {address}"
                )
            case "right":
                # Lax, not Strict: a link in a chat must open the page. Of others, no page that is
                # framed, no script and no websocket has it.
                cookie = f"{self._cookie}={self._value}; Path=/; HttpOnly; Secure; SameSite=Lax"
                moved = (("Location", "/"), ("Set-Cookie", cookie))
                return PageReply(HTTPStatus.SEE_OTHER, (*_UNSEEN, *moved))


_UNSEEN = (("Cache-Control", "no-store"), ("Referrer-Policy", "no-referrer"))
_AS_PAGE = (
    ("Content-Type", "text/html; charset=utf-8"),
    (
        "Content-Security-Policy",
        "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'",
    ),
    *_UNSEEN,
)


def _cookie_of(headers: Mapping[str, str], name: str) -> str:
    # The library's parser stops at a cookie of another server that it does not like.
    pairs = (each.strip().partition("=") for each in headers.get("Cookie", "").split(";"))
    return next((value for found, _, value in pairs if found == name), "")


# viser connects while its document has the focus. One in a frame has not, until it is clicked.
# It tries again each second, and whenever the document gets the focus, and gives up the attempt
# before: over a link with a longer way it never connects. Here each attempt lasts to its end.
_SCRIPT = b"""<script>if(parent!==window)document.hasFocus=()=>true;{
const post=Worker.prototype.postMessage,trying=new Set,known=new WeakSet;
Worker.prototype.postMessage=function(message,...more){const type=message&&message.type;
if(type==='retry'&&trying.has(this))return;
if(type==='retry'||type==='set_server'){trying.add(this);if(!known.has(this)){known.add(this);
this.addEventListener('message',({data})=>{
if(data.type==='connected'||data.type==='closed')trying.delete(this)})}}
return post.call(this,message,...more)}}</script>"""
_HEAD = b"<head>"


@dataclass
class Guard:
    """Decides which requests to a server at `host` are served: of its own pages and of programs,
    and with an `access` only the ones with its token.

    If `is_framed`, pages of other machines may have the page in a frame. Calls `on_refused(reason)`
    for each request that is refused, except one without a token. It `stands` once a server asks it.
    """

    host: str
    access: Access | None = None
    is_framed: bool = False
    on_refused: Callable[[str], object] = lambda reason: None
    stands: bool = False

    def __post_init__(self) -> None:
        names = machine_names(self.host)
        if self.access is not None:
            names |= own_names() | self.access.tls.names
        self._gate = PageGate(names, knows_neighbours=not names, advice="open the view directly")

    def check(self, then: Callable[..., Any], connection: Any, request: Request) -> Response | None:
        """The answer to a request, None for a websocket: `then(...)`, or a refusal."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        if reason := self._gate.stranger(host) or self._gate.refusal(origin, host):
            self.on_refused(reason)
            return _response(HTTPStatus.FORBIDDEN, f"{reason}\n")
        if self.access is not None:
            address = str((connection.remote_address or ("",))[0])
            if given := self.access.answer(request.path, request.headers, address):
                if given.reason:
                    self.on_refused(given.reason)
                return _response(given.status, given.body, given.headers)
        answer: Response | None = then(connection, request)
        if answer is None:
            _keep_queue_short(connection)
            return None
        if not self.is_framed:
            only_framed_here(answer, is_public=self.access is not None)
        return connecting_in_frames(answer)


@contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Make the server that viser starts meanwhile ask this guard.

    viser passes on neither headers nor `origins` nor `ssl`, so it gets a `serve` that does. The
    guard stands once that was called: a viser that starts its server in another way does not ask.
    """
    serve = server.serve
    tls = {} if guard.access is None else {"ssl": guard.access.tls.context}

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> server.serve:
        guard.stands = True
        checked = partial(guard.check, process_request)
        return serve(*args, process_request=checked, **(options | tls))

    # viser only calls it: a function does for the class.
    server.serve = guarded  # type: ignore[assignment, misc]  # a class for mypy
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]  # the same


def _response(status: HTTPStatus, body: str, headers: Collection[tuple[str, str]] = ()) -> Response:
    return Response(status.value, status.phrase, Headers(headers), body.encode())


def connecting_in_frames(response: Response) -> Response:
    """The response; a page of HTML with a script that makes it connect in a frame, too."""
    headers = response.headers
    if not headers.get("Content-Type", "").startswith("text/html") or not response.body:
        return response
    is_packed = headers.get("Content-Encoding") == "gzip"
    response.body = _with_script(bytes(response.body), is_packed)
    if "Content-Length" in headers:
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))
    return response


def only_framed_here(response: Response, *, is_public: bool) -> None:
    """Let no page of another machine frame it: a click on that one could be one on this.

    A page that others can reach is framed by itself only.
    """
    here = "" if is_public else " http://localhost:* http://127.0.0.1:*"
    response.headers["Content-Security-Policy"] = f"frame-ancestors 'self'{here}"


# Several megabytes, the same for all.
@lru_cache(4)
def _with_script(body: bytes, is_packed: bool) -> bytes:
    page = gzip.decompress(body) if is_packed else body
    page = page.replace(_HEAD, _HEAD + _SCRIPT, 1)
    return gzip.compress(page, 6) if is_packed else page


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
    except (OSError, UnicodeError) as error:
        reason = (error.strerror or error) if isinstance(error, OSError) else NO_HOST_NAME
        raise ServeError(
            f"cannot listen on {host!r}: {reason}; 127.0.0.1 is this machine alone"
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
    # Before viser's own at the exit of a program that has not stopped it, which writes a line.
    atexit.register(_stop_left, weakref.ref(server))
    _put_in_lanes(server)
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


def _put_in_lanes(server: viser.ViserServer) -> None:
    """Send each browser large messages as its link allows."""
    messages: Any = getattr(server, "_websock_server").get_message_buffer()  # noqa: B009
    windows = messages.window_generator

    def window_generator(client: int, backlog_done_message: Any = None) -> Any:
        whole = windows(client, backlog_done_message=backlog_done_message)
        return in_lanes(whole, backlog_done_message)

    messages.window_generator = window_generator


# So many bytes wait in the system for a link: behind more a browser would get old frames.
_UNSENT_BYTES = 32_768


def _keep_queue_short(connection: Any) -> None:
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    opened = connection.transport.get_extra_info("socket")
    if option is not None and opened is not None:
        with suppress(OSError):  # not on a socket of another kind
            opened.setsockopt(socket.IPPROTO_TCP, option, _UNSENT_BYTES)


# On a busy machine the thread of a server ends, and says so, after viser's `stop` has returned.
_STOP_S = 20.0


def stop(server: viser.ViserServer) -> None:
    """Stop a server of viser, without a word of it on standard output."""
    thread = getattr(getattr(server, "_websock_server", None), "_server_thread", None)
    with silent_viser():
        server.stop()
        if thread is not None:
            thread.join(_STOP_S)


def _stop_left(server: weakref.ref[viser.ViserServer]) -> None:
    if left := server():
        stop(left)


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
