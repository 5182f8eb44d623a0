"""The errors of tfbus: one family, and a class for each different remedy.

    TfbusError
      TransformException              a lookup or an insert that could not be done
        LookupException                 a frame that the buffer has never heard of
        ConnectivityException           two frames in trees that are not joined
        ExtrapolationException          an edge of the path has no data for that time
          PastExtrapolationException      older than its oldest sample: waiting will not help
          FutureExtrapolationException    newer than its newest sample: wait, or ask for latest
          NoDataException                 it has no sample at all
          SingleSampleException           it has one sample, of another time
        StaleException                  an edge older than was asked for, or without a publisher
        InvalidArgumentException        a name, number or shape that can never be right
          LoopException                   an edge that would close a loop in the tree
        TimeoutException                waited as long as asked; `reason` is what was missing
      DecodeError                     bytes that are not a message
      BusError                        trouble with Zenoh, or a session that is closed
      ServiceError                    a service that refused, or did not answer
      ParameterError                  an unknown parameter, or a value that it refuses
      InvalidNameError                a name of a node, topic or service that cannot be
      SettingsError                   a setting or option that cannot be

The names of the transform errors are tf2's. Each says in one sentence what was wrong and what to
do about it, and carries the facts as fields.
"""


class TfbusError(Exception):
    """Root of all errors that tfbus raises on purpose."""


class TransformException(TfbusError):
    """Root of the errors of transforms and the buffer."""


class LookupException(TransformException):
    """A frame that the buffer has never heard of.

    `frame` is the name asked for; `nearest` are up to three known names that look like it.
    """

    def __init__(self, message: str, *, frame: str = "", nearest: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.frame = frame
        self.nearest = nearest


class ConnectivityException(TransformException):
    """Both frames are known, but no common ancestor joins them.

    `target_root` and `source_root` are the topmost frames of the two trees.
    """

    def __init__(
        self,
        message: str,
        *,
        target_frame: str = "",
        source_frame: str = "",
        target_root: str = "",
        source_root: str = "",
    ) -> None:
        super().__init__(message)
        self.target_frame = target_frame
        self.source_frame = source_frame
        self.target_root = target_root
        self.source_root = source_root


class ExtrapolationException(TransformException):
    """An edge of the path has no data for the time asked for, and tfbus does not invent any.

    The edge is `frame_id` (parent) and `child_frame_id`; `authority` is who published its newest
    sample. Stamps are nanoseconds since the Unix epoch; `oldest_ns` and `newest_ns` are None
    where the edge has no sample. `retry_after_s` is in how many seconds the data is likely to be
    there, judged by the edge's own rate; None where waiting will not help or nobody can tell.
    """

    def __init__(
        self,
        message: str,
        *,
        frame_id: str = "",
        child_frame_id: str = "",
        requested_ns: int | None = None,
        oldest_ns: int | None = None,
        newest_ns: int | None = None,
        authority: str = "",
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(message)
        self.frame_id = frame_id
        self.child_frame_id = child_frame_id
        self.requested_ns = requested_ns
        self.oldest_ns = oldest_ns
        self.newest_ns = newest_ns
        self.authority = authority
        self.retry_after_s = retry_after_s


class PastExtrapolationException(ExtrapolationException):
    """The time asked for is older than the oldest sample of an edge; waiting will not help."""


class FutureExtrapolationException(ExtrapolationException):
    """The time asked for is newer than the newest sample of an edge."""


class NoDataException(ExtrapolationException):
    """An edge of the path is known, but holds no sample."""


class SingleSampleException(ExtrapolationException):
    """An edge of the path holds exactly one sample, and it is of another time.

    Of a time before it, waiting will not help.
    """


class StaleException(TransformException):
    """An edge of the path is older than `max_age_s`, or its publisher is gone and `living` asked.

    The edge is `frame_id` (parent) and `child_frame_id`; `authority` is who published its newest
    sample. `age_s` is how old that sample is, None of a static edge, which has no age. `gone` is
    whether its publisher is gone.
    """

    def __init__(
        self,
        message: str,
        *,
        frame_id: str = "",
        child_frame_id: str = "",
        authority: str = "",
        age_s: float | None = None,
        gone: bool = False,
    ) -> None:
        super().__init__(message)
        self.frame_id = frame_id
        self.child_frame_id = child_frame_id
        self.authority = authority
        self.age_s = age_s
        self.gone = gone


class InvalidArgumentException(TransformException):
    """A name, number or shape that can never be right."""


class LoopException(InvalidArgumentException):
    """An edge that would close a loop in the tree of frames.

    `path` is the chain of frames that already leads from the new parent up to the new child;
    `authority` sent the refused edge, and `other_authority` the edge above the new parent.
    """

    def __init__(
        self,
        message: str,
        *,
        path: tuple[str, ...] = (),
        authority: str = "",
        other_authority: str = "",
    ) -> None:
        super().__init__(message)
        self.path = path
        self.authority = authority
        self.other_authority = other_authority


class TimeoutException(TransformException):
    """The transform did not become available in time; `reason` is the error without waiting."""

    def __init__(self, message: str, *, reason: TransformException | None = None) -> None:
        super().__init__(message)
        self.reason = reason


class DecodeError(TfbusError):
    """Bytes that are not a message."""


class BusError(TfbusError):
    """Trouble with Zenoh, or a session that is closed."""


class ServiceError(TfbusError):
    """A service that refused the request, or did not answer."""


class ParameterError(TfbusError):
    """An unknown parameter, or a value of the wrong type or out of its range."""


class InvalidNameError(TfbusError):
    """A name of a node, topic or service that cannot be."""


class SettingsError(TfbusError):
    """A setting or a command-line option that cannot be."""
