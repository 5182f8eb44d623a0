"""Messages as Zenoh hands them out: samples, payloads, replies."""

from typing import Any

import zenoh


class Payload:
    """Bytes as Zenoh hands them out."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data

    def __bytes__(self) -> bytes:
        return self._data


class Source:
    """The origin of a message: the id of the session, that of the publisher, and its number."""

    def __init__(self, zid: str, eid: int, number: int) -> None:
        self.zid, self.eid = zid, eid
        self.source_id = self
        self.source_sn = number


class Sample:
    """A message, or the news of a token."""

    def __init__(
        self,
        key: str,
        payload: bytes = b"",
        kind: Any = zenoh.SampleKind.PUT,
        source: Source | None = None,
    ) -> None:
        self.key_expr = key
        self.payload = Payload(payload)
        self.kind = kind
        self.source_info = source


class ReplyError:
    """The reason why there is no answer."""

    def __init__(self, payload: bytes) -> None:
        self.payload = Payload(payload)


class Reply:
    """An answer to a query, or the reason for none."""

    def __init__(
        self, ok: Sample | None = None, error: bytes | None = None, zid: str | None = None
    ) -> None:
        self.ok = ok
        self.err = None if error is None else ReplyError(error)
        self.replier_id = None if zid is None else Source(zid, 0, 0)
