"""Access to a page that others can reach: those with its token, over an encrypted connection.

The token is in the address that is printed, or typed into a form. The browser then gets a cookie
made of it, which no script reads and no other site's page sends, and an address without it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from urllib.parse import parse_qs, quote

from tfbus.secure.server_access import AccessToken, ServerTls, is_same

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
class Answer:
    """The answer to a request in place of what it asks for; `reason` is for a log."""

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

    def answer(self, path: str, headers: Mapping[str, str], address: str) -> Answer | None:
        """The answer to a request from an address in place of what it asks for; None if it has the
        cookie.
        """
        if is_same(_cookie_of(headers, self._cookie), self._value):
            return None
        given = parse_qs(path.partition("?")[2]).get("token", [""])[0]
        if not given or headers.get("Upgrade"):
            return Answer(HTTPStatus.UNAUTHORIZED, _AS_PAGE, _FORM)
        match self.token.judge(given, address):
            case "too often":
                body = _FORM.replace("<!-- why -->", _TOO_OFTEN)
                return Answer(
                    HTTPStatus.TOO_MANY_REQUESTS, (*_AS_PAGE, ("Retry-After", "60")), body
                )
            case "wrong":
                body = _FORM.replace("<!-- why -->", _WRONG)
                return Answer(
                    HTTPStatus.UNAUTHORIZED, _AS_PAGE, body, f"a wrong token from {address}"
                )
            case "right":
                # Lax, not Strict: a link in a chat must open the page. Of others, no page that is
                # framed, no script and no websocket has it.
                cookie = f"{self._cookie}={self._value}; Path=/; HttpOnly; Secure; SameSite=Lax"
                moved = (("Location", "/"), ("Set-Cookie", cookie))
                return Answer(HTTPStatus.SEE_OTHER, (*_UNSEEN, *moved))


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
