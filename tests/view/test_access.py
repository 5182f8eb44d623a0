"""Access to the page if others can reach it."""

import pytest

from tfbus.command.server_access import AccessToken

pytest.importorskip("viser", reason="needs viser: the extra view")
pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tfbus.command.server_access import made_tls
from tfbus.view.server import Access, PageReply

TLS = made_tls("127.0.0.1")


@pytest.fixture
def access() -> Access:
    """With a token that was given."""
    return Access(AccessToken("correct horse"), TLS)


def cookie(answer: PageReply | None) -> str:
    """What a browser sends after an answer that sets a cookie."""
    assert answer is not None
    return dict(answer.headers)["Set-Cookie"].partition(";")[0]


def status(answer: PageReply | None) -> int:
    """Of an answer; 200 for what goes on to the page."""
    return 200 if answer is None else answer.status.value


def test_the_token_gets_a_cookie_and_an_address_without_it(access: Access) -> None:
    """The cookie is not the token, and no script, no other site and no plain HTTP has it."""
    answer = access.answer("/?token=correct+horse", {}, "10.0.0.7")
    assert answer is not None
    headers = dict(answer.headers)
    assert (answer.status, headers["Location"]) == (303, "/")
    assert headers["Set-Cookie"].endswith("; Path=/; HttpOnly; Secure; SameSite=Lax")
    assert "correct" not in headers["Set-Cookie"]
    assert access.answer("/assets/a.js", {"Cookie": cookie(answer)}, "10.0.0.7") is None


def test_without_the_token_each_path_is_the_form(access: Access) -> None:
    """Files and websockets too; nothing says whether a path exists."""
    for path in ("/", "/index.html", "/nothing", "/../../etc/passwd", "//[", "/?token="):
        assert status(access.answer(path, {}, "10.0.0.7")) == 401


def test_a_websocket_needs_the_cookie(access: Access) -> None:
    """The token in its address is none: scripts of other pages could try them."""
    upgrade = {"Upgrade": "websocket"}
    assert status(access.answer("/?token=correct+horse", upgrade, "10.0.0.7")) == 401
    cookies = {"Cookie": cookie(access.answer("/?token=correct+horse", {}, "10.0.0.7"))}
    assert access.answer("/", upgrade | cookies, "10.0.0.7") is None


def test_a_wrong_token_is_said_and_limited(access: Access) -> None:
    """To the browser, and with its address to the log."""
    answer = access.answer("/?token=wrong", {}, "10.0.0.7")
    assert answer is not None and "not the token" in answer.body
    assert (answer.status, answer.reason) == (401, "a wrong token from 10.0.0.7")
    for _ in range(9):
        access.answer("/?token=wrong", {}, "10.0.0.7")
    assert status(access.answer("/?token=correct+horse", {}, "10.0.0.7")) == 429


def test_a_cookie_is_found_among_those_of_other_servers(access: Access) -> None:
    """A host has one set of cookies for all its ports, and some are malformed."""
    own = cookie(access.answer("/?token=correct+horse", {}, "10.0.0.7"))
    assert access.answer("/", {"Cookie": f'a={{"b": [1]}}; ;=;{own}'}, "10.0.0.7") is None
    name = own.partition("=")[0]
    for wrong in (f"{name}=", f"{name}=correct horse", f"x{own}", own.replace("view", "v")):
        assert status(access.answer("/", {"Cookie": wrong}, "10.0.0.7")) == 401


def test_two_pages_of_a_machine_have_their_own_cookies(access: Access) -> None:
    """Otherwise each would close the other in the same browser."""
    own = cookie(access.answer("/?token=correct+horse", {}, "10.0.0.7"))
    other = Access(AccessToken("battery staple"), TLS)
    its = cookie(other.answer("/?token=battery+staple", {}, "10.0.0.7"))
    both = {"Cookie": f"{own}; {its}"}
    assert access.answer("/", both, "10.0.0.7") is other.answer("/", both, "10.0.0.7") is None


def test_a_token_that_was_given_is_not_in_the_printed_address(access: Access) -> None:
    """A token that was made for this run must be."""
    assert access.query == ""
    token = AccessToken()
    assert Access(token, TLS).query == f"/?token={token.text}"
