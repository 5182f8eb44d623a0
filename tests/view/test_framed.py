"""The page in a frame of another one."""

import gzip

import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from websockets.datastructures import Headers
from websockets.http11 import Response

from tfbus.view.server import connecting_in_frames


def test_a_page_in_a_frame_takes_itself_for_focused() -> None:
    """viser connects only then; what is no page stays as it is."""
    for pack, unpack, more in (
        (bytes, bytes, {}),
        (gzip.compress, gzip.decompress, {"Content-Encoding": "gzip"}),
    ):
        body = pack(b"<!doctype html><html><head><title>tfbus</title>")
        headers = Headers({"Content-Type": "text/html; charset=utf-8", **more})
        headers["Content-Length"] = str(len(body))
        sent = connecting_in_frames(Response(200, "OK", headers, body))
        assert b"<head><script>if(parent!==window)document.hasFocus=" in unpack(bytes(sent.body))
        assert sent.headers.get_all("Content-Length") == [str(len(sent.body))]
    picture = Response(200, "OK", Headers({"Content-Type": "image/png"}), b"<head>")
    assert connecting_in_frames(picture).body == b"<head>"
