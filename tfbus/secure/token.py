"""The token of a page or server that others can reach: who has it gets in."""

import hmac
import ipaddress
import secrets
import time
from collections import OrderedDict
from pathlib import Path
from typing import Literal

from tfbus.errors import SettingsError
from tfbus.secure.folder import check_is_private

# A token that someone chose has at least as many characters: with few guesses that is enough.
LEAST = 12

# From one address as many wrong tokens are answered in this time.
_GUESSES = 10
_WITHIN_S = 60.0

# Of addresses that guessed; of more, those that guessed first are forgotten.
_MOST_ADDRESSES = 10_000

Verdict = Literal["right", "wrong", "too often"]


class Token:
    """A secret text, and who has guessed at it; for one thread.

    Without a text it is new: 128 random bits. Raises SettingsError for a text that is too short.
    """

    def __init__(self, text: str = "") -> None:
        if text and len(text) < LEAST:
            raise SettingsError(
                f"the token has {len(text)} characters, and needs at least {LEAST}; where none is "
                "given, one is made"
            )
        self.is_new = not text
        self.text = text or secrets.token_urlsafe(16)
        self._guesses: OrderedDict[str, list[float]] = OrderedDict()

    def derived(self, purpose: str) -> str:
        """A text of 64 digits and letters a to f that only who has the token can make."""
        return hmac.new(self.text.encode(), purpose.encode(), "sha256").hexdigest()

    def judge(self, given: str, address: str) -> Verdict:
        """Whether a text from an address is the token; after 10 wrong ones in a minute, none is."""
        who = _network_of(address)
        now_s = time.monotonic()
        recent = [at_s for at_s in self._guesses.get(who, ()) if now_s - at_s < _WITHIN_S]
        if len(recent) >= _GUESSES:
            return "too often"
        if is_same(given, self.text):
            return "right"
        self._guesses[who] = [*recent, now_s]
        self._guesses.move_to_end(who)
        if len(self._guesses) > _MOST_ADDRESSES:
            self._guesses.popitem(last=False)
        return "wrong"

    def __repr__(self) -> str:
        return "Token(...)"


def is_same(given: str, secret: str) -> bool:
    """Whether a text is a secret; takes as long for any text of its length."""
    return hmac.compare_digest(given.encode(errors="replace"), secret.encode())


def read_token(path: Path) -> Token:
    """The token in a file: its first line.

    Raises SettingsError if there is none, the file cannot be read, or others may read it.
    """
    try:
        check_is_private(path, "token")
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"the token cannot be read from {path}: {error}") from error
    text = lines[0].strip() if lines else ""
    if not text:
        raise SettingsError(f"{path} has no token in its first line")
    return Token(text)


def _network_of(address: str) -> str:
    """Of IPv6 the first half: one machine has all addresses of it."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 4:
        return address
    return str(ipaddress.ip_network((int(found), 64), strict=False).network_address)
