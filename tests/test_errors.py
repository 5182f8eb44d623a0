"""The errors of tfbus are Python's errors too, if Python has one of the same meaning."""

import pickle

import pytest

import tfbus
from tfbus import Buffer, NoDataException, TimeoutException, Transform
from tfbus.base.wording import near_names


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
        ("FileError", OSError),
        ("MissingFileError", FileNotFoundError),
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
    assert (copy.fact, str(copy.reason), copy.errno) == ("timed out", "no sample", None)
    assert str(copy) == "timed out: no sample"


def test_python_catches_what_a_buffer_raises() -> None:
    """By the names that a Python programmer would write."""
    with pytest.raises(TimeoutError, match="no frame 'map'"):
        Buffer().lookup_transform("map", "base", timeout_s=0.001)
    with pytest.raises(LookupError, match=r"^there .*'map'"):
        Buffer().lookup_transform("map", "base")
    with pytest.raises(ValueError, match="norm 0"):
        Transform(quat_xyzw=(0, 0, 0, 0))


def test_a_message_is_the_fact_and_the_advice() -> None:
    """Both are fields, and the sentence follows them; the advice to wait stands first."""
    error = NoDataException("no sample", waiting="wait for one", advice="query another frame")
    assert str(error) == "no sample; wait for one, or query another frame"
    error.waiting = ""
    assert str(error) == "no sample; query another frame"
    error.advice = ""
    assert str(error) == error.fact == "no sample"
    assert str(tfbus.BusError("closed", advice="open it")) == "closed; open it"


def test_the_advice_on_an_unknown_frame_is_made_of_the_names() -> None:
    """That look like it, or all of them; also of an error that came from another process."""
    error = tfbus.LookupException("no frame", frame="base_lnk", known=["base_link", "map"])
    copy = pickle.loads(pickle.dumps(error))
    assert copy.nearest == error.nearest == ("base_link",)
    assert "'base_link'" in copy.advice
    assert "a, b" in tfbus.LookupException("no frame", frame="zzz", known=["b", "a"]).advice
    error.advice = "look again"
    assert str(error) == "no frame; look again"


def test_of_many_names_only_the_likely_ones_are_compared() -> None:
    """The near one is found among thousands, though few are compared letter by letter."""
    names = [f"robot{i}/camera_link" for i in range(3000)]
    assert "robot7/camera_link" in near_names("robot7/camra_link", names)
    assert near_names("robot7/camera_lnk", names[:500])[0] == "robot7/camera_link"
