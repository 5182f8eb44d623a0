"""A buffer in a file: it answers as before, and no other file becomes a buffer."""

import json
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.builders import S, examples, moved, transforms
from tfbus import Buffer, DecodeError, LoopException, Sampling, TransformException, TransformStamped
from tfbus.buffer.files import load, save

FRAMES = ["map", "odom", "base", "tool"]


def rich() -> Buffer:
    """A buffer with all that one can hold: two parents, conflicts, a static frame that was not."""
    buffer = Buffer(20.0, sampling=Sampling(interpolation="screw"))
    for second in range(1, 8):
        buffer.set_transform(moved(second * S, "map", "odom", second / 3), authority="slam")
        parent = "odom" if second < 4 else "map"
        buffer.set_transform(moved(second * S, parent, "base", second / 7), authority="wheels")
        buffer.set_transform(moved(second * S, "base", "tool", 0.1 * second), authority="arm")
    buffer.set_transform(moved(7 * S, "map", "base", 9.0), authority="wheels")
    buffer.set_transform(moved(8 * S, "base", "tool", 0.3), static=True, authority="urdf")
    buffer.mark_gone(["odom"], True, "slam")
    return buffer


def answers(buffer: Buffer, sampling: Sampling | None = None) -> list[Any]:
    """What it says of all pairs of frames at many times, and the kind of each error."""
    found: list[Any] = []
    for target in FRAMES:
        for source in FRAMES:
            for stamp_ns in (None, *range(0, 9 * S, S // 3)):
                try:
                    found.append(
                        buffer.lookup_transform(target, source, stamp_ns, sampling=sampling)
                    )
                except TransformException as error:
                    found.append(str(error))
    return found


def saved(buffer: Buffer, path: Path) -> Buffer:
    """The buffer after a file."""
    save(buffer, path)
    return load(path)


def test_all_that_a_buffer_holds_comes_back(tmp_path: Path) -> None:
    """Frames, samples, publishers, counts, settings, and each answer to the last bit."""
    before = rich()
    after = saved(before, tmp_path / "a.npz")
    assert after.all_frames() == before.all_frames()
    assert answers(after) == answers(before)
    assert answers(after, Sampling()) == answers(before, Sampling())
    assert (after.cache_time_s, after.sampling) == (before.cache_time_s, before.sampling)
    assert after.sent_by("arm") == before.sent_by("arm")
    assert after.sent_by("wheels") == before.sent_by("wheels")


def test_a_loaded_buffer_goes_on_as_the_saved_one(tmp_path: Path) -> None:
    """New samples, late ones, and changes of parent and publisher do the same to both."""
    before = rich()
    after = saved(before, tmp_path / "a.npz")
    for buffer in (before, after):
        for stamp_ns, parent, child in (
            (9 * S, "map", "base"),
            (5 * S // 2, "odom", "base"),
            (10 * S, "odom", "base"),
            (11 * S, "map", "tool"),
            (40 * S, "map", "odom"),
        ):
            buffer.set_transform(moved(stamp_ns, parent, child, 0.4), authority="wheels")
        buffer.remove("tool")
        buffer.clear(after_ns=30 * S)
    assert after.all_frames() == before.all_frames()
    assert answers(after) == answers(before)


def test_a_loaded_tree_refuses_a_loop(tmp_path: Path) -> None:
    """It counts children as the saved one did, also where a parent is removed."""
    before = Buffer()
    before.set_transform(moved(S, "A", "B"), static=True)
    after = saved(before, tmp_path / "a.npz")
    with pytest.raises(LoopException):
        after.set_transform(moved(S, "B", "A"), static=True)
    after.remove("A")
    assert after.frames() == ["A", "B"]


def test_samples_below_a_removed_frame_stay_unconnected(tmp_path: Path) -> None:
    """Also from a frame of the same name that comes later."""
    before = Buffer()
    before.set_transform(moved(S, "A", "C"))
    before.set_transform(moved(2 * S, "B", "C"))
    before.remove("A")
    after = saved(before, tmp_path / "a.npz")
    for buffer in (before, after):
        buffer.set_transform(moved(3 * S, "B", "A"), static=True)
        with pytest.raises(TransformException):
            buffer.lookup_transform("A", "C", S)
    assert after.all_frames() == before.all_frames()


def test_the_limit_of_samples_stays(tmp_path: Path) -> None:
    """And so does the count of those that were dropped."""
    before = Buffer(max_samples=2)
    for second in range(5):
        before.set_transform(moved(second * S, "map", "base"))
    after = saved(before, tmp_path / "a.npz")
    assert after.frame("base").crowded_out == 3
    after.set_transform(moved(6 * S, "map", "base"))
    assert (after.frame("base").samples, after.frame("base").crowded_out) == (2, 4)


def test_a_static_pose_of_a_former_epoch_yields_after_loading(tmp_path: Path) -> None:
    """An edge the other way round replaces it."""
    before = Buffer()
    before.set_transform(moved(S, "A", "B"), static=True, authority="urdf")
    before.forget("urdf")
    after = saved(before, tmp_path / "a.npz")
    after.set_transform(moved(S, "B", "A"), static=True, authority="urdf")
    assert after.frame("A").parent == "B"


def test_a_file_of_an_earlier_release_has_the_defaults(tmp_path: Path) -> None:
    """It does not say the limit of samples, what ended, and what was dropped."""

    def without(header: dict[str, Any]) -> None:
        del header["max_samples"]
        for frame in header["frames"]:
            del frame["ended"], frame["crowded_out"]

    changed(tmp_path / "a.npz", without)
    assert load(tmp_path / "a.npz").all_frames() == rich().all_frames()


FRAME = st.sampled_from(FRAMES)


@given(
    st.lists(st.tuples(FRAME, FRAME, st.integers(1, 12), transforms(), st.booleans()), max_size=25)
)
@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_buffer_answers_after_loading_as_before(tmp_path: Path, rows: list[Any]) -> None:
    """Whatever was inserted, in whatever order, dynamic and static."""
    before = Buffer(6.0)
    for parent, child, second, pose, static in rows:
        try:
            before.set_transform(TransformStamped(second * S, parent, child, pose), static=static)
        except TransformException:
            continue
    after = saved(before, tmp_path / "a.npz")
    assert after.all_frames() == before.all_frames()
    assert answers(after) == answers(before)


def test_an_unlimited_cache_and_an_empty_buffer_are_saved(tmp_path: Path) -> None:
    """Both are what they were."""
    assert saved(Buffer(math.inf), tmp_path / "a.npz").cache_time_s == math.inf
    assert saved(Buffer(0.5), tmp_path / "a.npz").cache_time_s == 0.5
    assert saved(Buffer(), tmp_path / "a.npz").frames() == []


def test_numpy_reads_the_file(tmp_path: Path) -> None:
    """Stamps and poses are arrays for any program, without pickle."""
    save(rich(), tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["stamps_ns"].shape == (21,)
        assert arrays["poses"].shape == (21, 7)
        assert json.loads(arrays["header"].tobytes())["version"] == 1


def test_an_error_while_writing_leaves_the_former_file(tmp_path: Path) -> None:
    """A file is replaced whole, and nothing is left beside it."""
    from tfbus.base.whole_file import replacing

    path = tmp_path / "a.npz"
    save(rich(), path)
    former = path.read_bytes()
    with pytest.raises(OSError, match="full"), replacing(path) as file:
        file.write(b"half")
        raise OSError("the disk is full")
    assert path.read_bytes() == former
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_not_there_is_an_error_of_the_system(tmp_path: Path) -> None:
    """As with any function of Python that opens files."""
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.npz")
    with pytest.raises(FileNotFoundError):
        save(Buffer(), tmp_path / "none" / "a.npz")


def test_a_file_that_was_cut_anywhere_is_refused(tmp_path: Path) -> None:
    """With DecodeError, which names the file."""
    path = tmp_path / "a.npz"
    save(rich(), path)
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        with pytest.raises(DecodeError, match=r"a\.npz is not a "):
            load(path)


def test_a_flipped_bit_is_refused_or_harmless(tmp_path: Path) -> None:
    """The archive has sums over all its parts; nothing but DecodeError is raised."""
    path = tmp_path / "a.npz"
    save(rich(), path)
    whole = path.read_bytes()
    for at in range(0, len(whole), 41):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            load(path)
        except DecodeError:
            continue


def test_other_archives_are_refused(tmp_path: Path) -> None:
    """Arrays of something else, pickles, compressed members and other files."""
    path = tmp_path / "a.npz"
    np.savez(path, points=np.zeros(3))
    with pytest.raises(DecodeError, match="not the arrays header"):
        load(path)
    kinds: dict[str, Any] = {"header": np.zeros(2, np.uint8), "stamps_ns": np.zeros(0, np.int64)}
    kinds |= {"parents": np.zeros(0, np.int32), "poses": np.zeros((0, 7))}
    np.savez_compressed(path, **kinds)
    with pytest.raises(DecodeError, match="compressed"):
        load(path)
    np.savez(path, **{**kinds, "poses": np.array([{}], dtype=object)})
    with pytest.raises(DecodeError):
        load(path)
    np.savez(path, **kinds)
    with pytest.raises(DecodeError, match="not JSON"):
        load(path)


def test_an_array_that_claims_to_be_huge_takes_no_memory(tmp_path: Path) -> None:
    """The size in a header is judged by the bytes that are there."""
    path = tmp_path / "a.npz"
    save(rich(), path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts["stamps_ns.npy"] = parts["stamps_ns.npy"].replace(
        b"(21,), }     ", b"(2199023255552,), }"
    )
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    with pytest.raises(DecodeError):
        load(path)


def test_a_later_version_says_so(tmp_path: Path) -> None:
    """A file of a later tfbus names its version and the one that is read."""
    changed(tmp_path / "a.npz", lambda header: header.update(version=2))
    with pytest.raises(DecodeError, match=r"version 2 .*reads version 1"):
        load(tmp_path / "a.npz")


def _loop(header: dict[str, Any]) -> None:
    for frame in header["frames"]:
        if frame["name"] == "map":
            frame["parent"] = "base"


def _set(field: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda header: header["frames"][1].update({field: value})


@pytest.mark.parametrize(
    "change",
    [
        _loop,
        _set("name", "map"),
        _set("name", "/odom"),
        _set("name", "a\udc80"),
        _set("name", 3),
        _set("parent", None),
        _set("parent", "odom"),
        _set("parent", "nowhere"),
        _set("samples", 8),
        _set("samples", -1),
        _set("samples", 1e300),
        _set("authority", None),
        _set("static", {"stamp_ns": 1, "pose": [0, 0, 0, 0, 0, 0, 9]}),
        _set("static", {"stamp_ns": 2**70, "pose": [0, 0, 0, 0, 0, 0, 1]}),
        _set("static", {"stamp_ns": 1, "pose": [math.nan, 0, 0, 0, 0, 0, 1]}),
        _set("static", 7),
        _set("mixed_until_ns", 2**64),
        _set("conflicts", "many"),
        _set("conflicts", 1.5),
        _set("refused", True),
        lambda header: header.update(max_samples=6),
        lambda header: header.update(max_samples=0),
        lambda header: header.update(max_samples="all"),
        _set("crowded_out", -1),
        lambda header: header.update(cache_time_s=-1),
        lambda header: header.update(cache_time_s="long"),
        lambda header: header.update(cache_time_s=True),
        lambda header: header.update(sampling={"interpolation": "magic"}),
        lambda header: header.update(sampling=[]),
        lambda header: header.update(frames=None),
        lambda header: header.update(frames=[[]]),
        lambda header: header.pop("frames"),
        lambda header: header.update(format="another"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    """No file makes a buffer with a loop, a wrong name or numbers out of range."""
    changed(tmp_path / "a.npz", change)
    with pytest.raises(DecodeError) as raised:
        load(tmp_path / "a.npz")
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    ("array", "value"),
    [
        ("stamps_ns", 0),
        ("stamps_ns", 2**63 - 1),
        ("parents", 77),
        ("parents", -1),
        ("poses", np.nan),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, array: str, value: Any) -> None:
    """Stamps that fall, unknown parents and poses that are none."""
    path = tmp_path / "a.npz"
    save(rich(), path)
    with np.load(path) as given_arrays:
        arrays = dict(given_arrays)
    arrays[array][3] = value
    np.savez(path, **arrays)
    with pytest.raises(DecodeError):
        load(path)


def changed(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """A saved buffer whose header was changed."""
    save(rich(), path)
    with np.load(path) as given_arrays:
        arrays = dict(given_arrays)
    header = json.loads(arrays["header"].tobytes())
    change(header)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path, **arrays)
