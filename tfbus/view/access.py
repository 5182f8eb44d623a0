"""Who may open a page that others can reach: those with its token, over an encrypted connection.

The token is in the address that is printed, or typed into a form. The browser then gets it as a
cookie, which no script reads and no other site's page sends, and an address without it.
"""

import hmac
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

_COOKIE = "tfbus_view"

# Who does not know the token may guess as often in this time.
_GUESSES = 10
_WITHIN_S = 60.0

_FORM = """\
<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>tfbus view</title>
<style>body{font:16px sans-serif;margin:4em auto;max-width:24em;padding:0 1em}
input,button{font:inherit;padding:.4em;width:100%;box-sizing:border-box;margin:.3em 0}
@media (prefers-color-scheme:dark){body{background:#1a1b1e;color:#c1c2c5}}</style>
<h1>tfbus view</h1><p>This page needs the token that <code>tfbus view</code> has printed.</p>
<form><input name="token" type="password" autofocus aria-label="token"><button>Open</button></form>
"""


@dataclass(frozen=True)
class Answer:
    """What a request is answered with in place of the page."""

    status: HTTPStatus
    headers: tuple[tuple[str, str], ...]
    body: str = ""


@dataclass
class Access:
    """The token of a page, and its end of encrypted connections."""

    token: str
    tls: ssl.SSLContext
    _failures: list[float] = field(default_factory=list, repr=False)

    def answer(self, path: str, headers: Mapping[str, str]) -> Answer | None:
        """What a request gets in place of what it asks for; None where it has the token."""
        if self._is(_cookie_of(headers)):
            return None
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if not given:
            return Answer(HTTPStatus.UNAUTHORIZED, _as_page(), _FORM)
        if self._has_failed_often():
            return Answer(HTTPStatus.TOO_MANY_REQUESTS, (("Retry-After", "60"),), "try later\n")
        if not self._is(given):
            self._failures.append(time.monotonic())
            wrong = _FORM.replace("<form>", "<p><b>That is not the token.</b></p><form>")
            return Answer(HTTPStatus.UNAUTHORIZED, _as_page(), wrong)
        cookie = f"{_COOKIE}={given}; Path=/; HttpOnly; Secure; SameSite=Strict"
        return Answer(HTTPStatus.SEE_OTHER, (("Location", "/"), ("Set-Cookie", cookie)))

    def _is(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self.token.encode())

    def _has_failed_often(self) -> bool:
        now_s = time.monotonic()
        self._failures = [at_s for at_s in self._failures if now_s - at_s < _WITHIN_S]
        return len(self._failures) >= _GUESSES


def _as_page() -> tuple[tuple[str, str], ...]:
    return (
        ("Content-Type", "text/html; charset=utf-8"),
        ("Cache-Control", "no-store"),
        ("Referrer-Policy", "no-referrer"),
    )


def _cookie_of(headers: Mapping[str, str]) -> str:
    try:
        found = SimpleCookie(headers.get("Cookie", "")).get(_COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value


def tls_of(certificate: str, key: str) -> ssl.SSLContext:
    """The server's end of encrypted connections. Raises OSError where a file cannot be read,
    ssl.SSLError, which is one, where it is not a certificate or key.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(certificate, key)
    return context
