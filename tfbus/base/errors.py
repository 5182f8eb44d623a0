"""The errors of tfbus: one family, with a class for each different remedy.

    TfbusError
      TransformException              a lookup or an insert failed
        LookupException                 a frame is unknown to the buffer
        ConnectivityException           the two frames are in separate trees
        ExtrapolationException          an edge of the path has no data for that time
          PastExtrapolationException      it is before the oldest sample: waiting does not help
          FutureExtrapolationException    it is after the newest sample: wait, or ask for the latest
          NoDataException                 the edge has no sample at all
          SingleSampleException           the edge has one sample, of another time
          GapException                    its samples around that time are too far apart
        StaleException                  an edge is too old, or its publisher is gone
        InvalidArgumentException        a name, number or shape is invalid
          LoopException                   an edge would close a loop in the tree
        TimeoutException                the wait ended; `reason` is the error that held until then
      DecodeError                     bytes are not a message
      BusError                        Zenoh failed, or the session is closed
      ServiceError                    a service or action refused, or did not answer
      ParameterError                  a parameter is unknown, or its value invalid
      InvalidNameError                a name of a node, topic, service or action is invalid
      SettingsError                   a setting or command-line option is invalid
      UrdfError                       a URDF or xacro file cannot be read, or is not one
      FileError                       a file of a recording cannot be opened
        MissingFileError                it is not there
      RightsError                     the identity may not do that on a closed bus

The names of the transform errors are tf2's. Each message is one sentence of the mistake, the
`fact`, and the remedy, the `advice`; it is made when it is printed. Names in it are fields.

If Python has an error of the same meaning, the class derives from it too, so that `except` of
either catches it:

    InvalidArgumentException, InvalidNameError, SettingsError, DecodeError,
    UrdfError                                                                 ValueError
    TimeoutException                                                          TimeoutError
    FileError                                                                 OSError
    MissingFileError                                                          FileNotFoundError
    LookupException                                                           LookupError

LookupException is no KeyError, whose `str` is the repr of its message.
"""

from collections.abc import Collection
from typing import Any

from tfbus.base.wording import listed, natural_order, near_names


class TfbusError(Exception):
    """Root of all errors that tfbus raises on purpose.

    `fact` names the mistake, and `advice` the remedy, "" if the fact says it already: the message
    is the one, a semicolon, and the other.
    """

    advice: str = ""

    def __init__(self, fact: str = "", *, advice: str = "") -> None:
        super().__init__(fact)
        if advice:
            self.advice = advice

    @property
    def fact(self) -> str:
        """The message without the advice."""
        # An OSError with an `errno` would begin its text with that.
        return str(self.args[0]) if self.args else ""

    def __str__(self) -> str:
        return "; ".join(filter(None, (self.fact, self.advice)))


class TransformException(TfbusError):
    """Root of the errors of transforms and the buffer.

    `waiting` is the advice to wait, "" if that does not help; it stands before `advice` in the
    message: `wait about 0.1 s (timeout_s), or query the latest`. `waiting_by` and `advice_by` are
    the parameters that do so, as `timeout_s`, "" for none.
    """

    waiting: str = ""
    waiting_by: str = ""
    advice_by: str = ""

    def __init__(
        self,
        fact: str = "",
        *,
        advice: str = "",
        waiting: str = "",
        waiting_by: str = "",
        advice_by: str = "",
    ) -> None:
        super().__init__(fact, advice=advice)
        if waiting:
            self.waiting, self.waiting_by = waiting, waiting_by
        if advice_by:
            self.advice_by = advice_by

    def __str__(self) -> str:
        pairs = (self.waiting, self.waiting_by), (self.advice, self.advice_by)
        remedies = ", or ".join(_with_parameter(*pair) for pair in pairs if pair[0])
        return "; ".join(filter(None, (self.fact, remedies)))


def _with_parameter(remedy: str, parameter: str) -> str:
    return f"{remedy} ({parameter})" if remedy and parameter else remedy


class LookupException(TransformException, LookupError):
    """A frame is unknown to the buffer.

    `frame` is the unknown name; `nearest` are up to three similar names that are `known` in its
    namespace (of `robot7/base` no `robot27/base`). They are sought, and the advice is made of them,
    when they are asked for.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        frame: str = "",
        nearest: tuple[str, ...] | None = None,
        known: Collection[str] | None = None,
        **words: str,
    ) -> None:
        super().__init__(fact, **words)
        self.frame = frame
        self.known = known
        self._nearest = nearest

    @property
    def nearest(self) -> tuple[str, ...]:
        """Up to three known names that are spelt most like the unknown one, best first."""
        if self._nearest is None:
            self._nearest = near_names(self.frame, self._beside)
        return self._nearest

    @property
    def _beside(self) -> list[str]:
        """The known names in the namespace of the unknown one: another robot's would answer another
        question.
        """
        namespace = self.frame.rpartition("/")[0]
        return [name for name in self.known or () if name.rpartition("/")[0] == namespace]

    @property
    def advice(self) -> str:
        """The names that may be meant, or the given advice."""
        given = vars(self).get("advice", "")
        if given or self.known is None:
            return str(given)
        if self.nearest:
            return f"did you mean {' or '.join(map(repr, self.nearest))}?"
        if beside := self._beside:
            return f"available: {listed(sorted(beside, key=natural_order))}"
        if self.known:
            return f"no frame is known in {self.frame.rpartition('/')[0]!r}"
        return "no frame is known so far"

    @advice.setter
    def advice(self, advice: str) -> None:
        vars(self)["advice"] = advice


class ConnectivityException(TransformException):
    """Both frames are known, but have no common ancestor.

    `target_root` and `source_root` are the topmost frames of the two trees.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        target_frame: str = "",
        source_frame: str = "",
        target_root: str = "",
        source_root: str = "",
        **words: str,
    ) -> None:
        super().__init__(fact, **words)
        self.target_frame = target_frame
        self.source_frame = source_frame
        self.target_root = target_root
        self.source_root = source_root


class ExtrapolationException(TransformException):
    """An edge of the path has no data for the requested time, and tfbus does not extrapolate.

    The edge is `frame_id` (parent) and `child_frame_id`; `authority` published its newest sample.
    Stamps are nanoseconds since the Unix epoch; `oldest_ns` and `newest_ns` are None if the edge
    has no sample. In `retry_after_s` seconds the data is likely to be there, by the edge's rate;
    None if waiting does not help, or the rate is unknown.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        frame_id: str = "",
        child_frame_id: str = "",
        requested_ns: int | None = None,
        oldest_ns: int | None = None,
        newest_ns: int | None = None,
        authority: str = "",
        retry_after_s: float | None = None,
        **words: str,
    ) -> None:
        super().__init__(fact, **words)
        self.frame_id = frame_id
        self.child_frame_id = child_frame_id
        self.requested_ns = requested_ns
        self.oldest_ns = oldest_ns
        self.newest_ns = newest_ns
        self.authority = authority
        self.retry_after_s = retry_after_s


class PastExtrapolationException(ExtrapolationException):
    """The requested time is before the oldest sample of an edge; waiting does not help."""


class FutureExtrapolationException(ExtrapolationException):
    """The requested time is after the newest sample of an edge."""


class NoDataException(ExtrapolationException):
    """An edge of the path is known, but has no sample."""


class SingleSampleException(ExtrapolationException):
    """An edge of the path has exactly one sample, of another time.

    For a time before it, waiting does not help.
    """


class GapException(ExtrapolationException):
    """The samples of an edge around the requested time are farther apart than `max_gap_s`.

    `before_ns` and `after_ns` are the stamps of the two; with extrapolation of the first two
    or the last two. For a given time waiting does not help; for the latest it may.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        before_ns: int = 0,
        after_ns: int = 0,
        max_gap_s: float | None = None,
        **facts: Any,
    ) -> None:
        super().__init__(fact, **facts)
        self.before_ns = before_ns
        self.after_ns = after_ns
        self.max_gap_s = max_gap_s


class StaleException(TransformException):
    """An edge of the path is older than `max_age_s`, or with `living=True` its publisher is gone.

    The edge is `frame_id` (parent) and `child_frame_id`; `authority` published its newest sample.
    `age_s` is the age of that sample, None for a static edge. `gone` is whether its publisher is
    gone.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        frame_id: str = "",
        child_frame_id: str = "",
        authority: str = "",
        age_s: float | None = None,
        gone: bool = False,
        **words: str,
    ) -> None:
        super().__init__(fact, **words)
        self.frame_id = frame_id
        self.child_frame_id = child_frame_id
        self.authority = authority
        self.age_s = age_s
        self.gone = gone


class InvalidArgumentException(TransformException, ValueError):
    """A name, number or shape is invalid."""


class LoopException(InvalidArgumentException):
    """An edge would close a loop in the tree of frames.

    `path` is the chain of frames from the new parent up to the new child; `authority` sent the
    refused edge, `other_authority` the edge above the new parent.
    """

    def __init__(
        self,
        fact: str = "",
        *,
        path: tuple[str, ...] = (),
        authority: str = "",
        other_authority: str = "",
        **words: str,
    ) -> None:
        super().__init__(fact, **words)
        self.path = path
        self.authority = authority
        self.other_authority = other_authority


class TimeoutException(TransformException, TimeoutError):
    """The transform did not become available in time; `reason` is the error without a wait.

    The message is the fact, and the one of the reason, without its advice to wait.
    """

    def __init__(
        self, fact: str = "", *, reason: TransformException | None = None, **words: str
    ) -> None:
        super().__init__(fact, **words)
        self.reason = reason

    def __str__(self) -> str:
        if self.reason is None:
            return super().__str__()
        said = self if self.advice else self.reason
        advice = _with_parameter(said.advice, said.advice_by)
        return "; ".join(filter(None, (f"{self.fact}: {self.reason.fact}", advice)))


class DecodeError(TfbusError, ValueError):
    """Bytes are not a message of the expected type."""


class BusError(TfbusError):
    """Zenoh failed, or the session is closed."""


class ServiceError(TfbusError):
    """A service or action refused, or did not answer."""


class ParameterError(TfbusError):
    """A parameter is unknown, or its value of the wrong type or out of range."""


class InvalidNameError(TfbusError, ValueError):
    """A name of a node, topic, service or action is invalid."""


class SettingsError(TfbusError, ValueError):
    """A setting or command-line option is invalid."""


class UrdfError(TfbusError, ValueError):
    """A URDF or xacro file cannot be read, or is not one; the message has the line."""


class FileError(TfbusError, OSError):
    """A file of a recording cannot be opened: `errno`, `strerror` and `filename` say why."""


class MissingFileError(FileError, FileNotFoundError):
    """A file of a recording is not there."""


class RightsError(TfbusError):
    """The identity of this process has no right to do that on its closed bus."""
