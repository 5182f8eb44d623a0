"""The errors of tfbus are Python's errors too, where Python has one of the same meaning."""

import pickle

import pytest

import tfbus
from tfbus import Buffer, NoDataException, TimeoutException, Transform


@pytest.mark.parametrize(
    ("error", "of_python"),
    [
        ("InvalidArgumentException", ValueError),
        ("LoopException", ValueError),
        ("InvalidNameError", ValueError),
        ("SettingsError", ValueError),
        ("DecodeError", ValueError),
        ("UrdfError", ValueError),
        ("TimeoutException", TimeoutError),
        ("LookupException", LookupError),
    ],
)
def test_an_error_is_pythons_too(error: str, of_python: type[Exception]) -> None:
    """`except ValueError` catches an invalid argument, as in any Python package."""
    raised = getattr(tfbus, error)("what is wrong")
    assert isinstance(raised, of_python) and isinstance(raised, tfbus.TfbusError)
    assert str(raised) == "what is wrong"


def test_a_timeout_keeps_its_reason() -> None:
    """TimeoutError is an OSError, which has arguments of its own: they do not get in the way."""
    timeout = TimeoutException("timed out", reason=NoDataException("no sample", frame_id="map"))
    copy = pickle.loads(pickle.dumps(timeout))
    assert (str(copy), str(copy.reason), copy.errno) == ("timed out", "no sample", None)


def test_python_catches_what_a_buffer_raises() -> None:
    """By the names that a Python programmer would write."""
    with pytest.raises(TimeoutError, match="there is no frame 'map'"):
        Buffer().lookup_transform("map", "base", timeout_s=0.001)
    with pytest.raises(LookupError, match=r"^there is no frame 'map'"):
        Buffer().lookup_transform("map", "base")
    with pytest.raises(ValueError, match="norm 0"):
        Transform(quat_xyzw=(0, 0, 0, 0))
