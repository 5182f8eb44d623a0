"""Which streams of a recording are seen from a namespace, and how names are called there."""

from tfbus.wire.fleet import Fleet, FrameNames


class Viewpoint:
    """A namespace, "" for none; with a fleet also the namespaces below it. Without a namespace,
    None, all streams are seen, and frames are called as they were sent.
    """

    def __init__(self, namespace: str | None = "", fleet: Fleet | None = None) -> None:
        self._sees_all = namespace is None
        self.namespace = (namespace or "").strip("/")
        self._fleet = fleet
        self._names: dict[str, FrameNames] = {}

    def called(self, stream: str, namespace: str) -> str | None:
        """The name of a stream, by its full name and its namespace; None where it is not seen."""
        if self._sees_all:
            return stream
        if namespace != self.namespace and (self._fleet is None or not self._is_below(namespace)):
            return None
        return stream.removeprefix(f"{self.namespace}/") if self.namespace else stream

    def names(self, namespace: str) -> FrameNames:
        """How the frames of a namespace are called."""
        names = self._names.get(namespace)
        if names is None:
            below = namespace.removeprefix(self.namespace).strip("/")
            fleet = self._fleet or Fleet()
            names = self._names[namespace] = fleet.names(below if self._fleet else "")
        return names

    def _is_below(self, namespace: str) -> bool:
        return not self.namespace or namespace.startswith(f"{self.namespace}/")
