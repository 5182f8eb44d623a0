"""The page within another one, such as a notebook: where that may be, and how it connects."""

import gzip
from functools import lru_cache

from websockets.http11 import Response

# viser connects while its document has the focus. One in a frame has not, until it is clicked.
_SCRIPT = b"<script>if(parent!==window)document.hasFocus=()=>true</script>"
_HEAD = b"<head>"


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
