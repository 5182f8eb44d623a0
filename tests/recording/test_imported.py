"""Files of ROS and Foxglove become recordings."""

import bz2
import shutil
import sqlite3
import tracemalloc
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard

from tests import needs
from tests.builders import examples
from tests.recording.foreign_files import (
    RawTransform,
    Sent,
    store_of,
    write_bag,
    write_bare_mcap,
    write_foxglove_json,
    write_rosbag2,
)
from tfbus.base.errors import DecodeError
from tfbus.recording import foreign_files
from tfbus.recording.foreign_files import opened
from tfbus.recording.imported import ForeignChannel, ForeignMessage, Imported, imported
from tfbus.recording.items import Item, Selection, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter

S = 1_000_000_000
START_NS = 1_700_000_000 * S
TEXT = "std_msgs/msg/String"
TURN = (0.0, 0.0, 0.6, 0.8)

Row = tuple[str, str, int, tuple[float, ...]]


def raw(stamp_ns: int, parent: str, child: str, x: float = 0.0) -> RawTransform:
    """A transform that is turned."""
    return RawTransform(stamp_ns, parent, child, (float(x), -0.0, 1e-300, *TURN))


SENT = [
    Sent(START_NS, [raw(START_NS, "/base", "/laser", 0.1)], "/tf_static", "/arm/state"),
    Sent(START_NS + 1, [raw(START_NS, "base", "camera", 0.2)], "/tf_static", "/arm/state"),
    *(
        Sent(START_NS + i * S // 10, [raw(START_NS + i, "map", "odom", i), raw(i, "odom", "base")])
        for i in range(1, 50)
    ),
    Sent(START_NS + 6 * S, [], "/tf"),
    Sent(START_NS + 7 * S, [raw(START_NS, "map", "base")], "/robot7/tf"),
]


def _packed_rosbag2(folder: Path, *, storage: str, packed: str) -> Path:
    return write_rosbag2(folder / "r", SENT, storage=storage, packed=packed)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "bag": lambda folder: write_bag(folder / "r.bag", SENT),
    "db3": lambda folder: write_rosbag2(folder / "r", SENT, storage="SQLITE3"),
    "rosbag2 mcap": lambda folder: write_rosbag2(folder / "r", SENT, storage="MCAP"),
    "bag of bzip2": lambda folder: write_bag(folder / "r.bag", SENT, compression="BZ2"),
    "bag of lz4": lambda folder: write_bag(folder / "r.bag", SENT, compression="LZ4"),
    **{
        f"{storage} packed by {packed}": partial(_packed_rosbag2, storage=storage, packed=packed)
        for storage in ("SQLITE3", "MCAP")
        for packed in ("FILE", "MESSAGE")
    },
    "mcap of ROS 2": lambda folder: write_bare_mcap(folder / "r.mcap", SENT, ros=2),
    "mcap of ROS 1": lambda folder: write_bare_mcap(folder / "r.mcap", SENT, ros=1),
    "mcap of Foxglove": lambda folder: write_foxglove_json(folder / "r.mcap", SENT),
}


def items_of(*paths: Path, counts: Imported | None = None, **options: Any) -> list[Item]:
    """What is imported of these files."""
    with opened(*paths) as files:
        return list(imported(files.messages(), counts or Imported(), **options))


def transforms_of(*paths: Path, **options: Any) -> list[TransformItem]:
    """The same, where it is transforms alone."""
    items = items_of(*paths, **options)
    assert all(isinstance(item, TransformItem) for item in items)
    return [item for item in items if isinstance(item, TransformItem)]


def messages_of(*paths: Path, **options: Any) -> list[TopicItem]:
    """The same, where it is messages of topics alone."""
    items = items_of(*paths, **options)
    assert all(isinstance(item, TopicItem) for item in items)
    return [item for item in items if isinstance(item, TopicItem)]


def rows_of(item: TransformItem) -> list[Row]:
    """The transforms of an item."""
    rows = item.rows
    batch = rows.as_batch()
    return [
        (rows.frames[parent], rows.frames[child], stamp_ns, tuple(pose))
        for (parent, child), stamp_ns, pose in zip(
            rows.pairs(), rows.stamps_as_ints(), batch.poses.tolist(), strict=True
        )
    ]


def sent_rows(sent: Iterable[Sent], topic: str) -> list[list[Row]]:
    """The same of what was sent on a topic, leading slashes removed."""
    return [
        [
            (ts.frame_id.lstrip("/"), ts.child_frame_id.lstrip("/"), ts.stamp_ns, tuple(ts.pose))
            for ts in each.transforms
        ]
        for each in sent
        if each.topic == topic
    ]


@pytest.fixture(params=WRITERS)
def foreign(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A file of each kind with what was sent."""
    return WRITERS[request.param](tmp_path)


def test_every_transform_is_imported_bit_by_bit(foreign: Path) -> None:
    """Names, stamps, log times and poses are those that were written, signs of zero too."""
    items = [item for item in items_of(foreign) if isinstance(item, TransformItem)]
    dynamic = [item for item in items if not item.static and not item.stream.namespace]
    assert [repr(rows_of(item)) for item in dynamic] == list(map(repr, sent_rows(SENT, "/tf")))
    assert [item.log_ns for item in items] == [each.log_ns for each in SENT]


def test_static_transforms_add_up(foreign: Path) -> None:
    """ROS sends some of them at a time; a recording has all of a stream each time."""
    statics = [
        item for item in items_of(foreign) if isinstance(item, TransformItem) and item.static
    ]
    assert [[row[1] for row in rows_of(item)] for item in statics] == [
        ["laser"],
        ["laser", "camera"],
    ]


def test_a_namespace_before_tf_is_that_of_the_stream(foreign: Path) -> None:
    """Transforms on /robot7/tf are apart from those on /tf."""
    last = items_of(foreign)[-1]
    assert isinstance(last, TransformItem)
    assert last.stream.namespace == "robot7"
    assert last.stream.name in ("robot7/ros", "robot7/foxglove")


def test_each_publisher_of_ros_1_is_a_stream(tmp_path: Path) -> None:
    """Rosbag1 says who sent a message; its name has no slash here."""
    sent = [
        Sent(START_NS + 1, [raw(1, "map", "odom")], "/tf", "/slam"),
        Sent(START_NS + 2, [raw(2, "odom", "base")], "/tf", "/robot/ekf"),
    ]
    items = transforms_of(write_bag(tmp_path / "r.bag", sent))
    assert [(item.stream.name, item.stream.node) for item in items] == [
        ("slam", "/slam"),
        ("robot_ekf", "/robot/ekf"),
    ]


def test_several_files_are_one_in_order_of_time(tmp_path: Path) -> None:
    """The parts of a recording, given in any order."""
    later = write_bag(tmp_path / "b.bag", [Sent(START_NS + S, [raw(2, "map", "odom")])])
    first = write_rosbag2(tmp_path / "a", [Sent(START_NS, [raw(1, "map", "odom")])], storage="MCAP")
    assert [item.log_ns for item in items_of(later, first)] == [START_NS, START_NS + S]


def test_a_folder_without_metadata_is_read_by_its_files(tmp_path: Path) -> None:
    """As where the recorder of rosbag2 was killed; part 10 comes after part 9."""
    folder = tmp_path / "r"
    folder.mkdir()
    for part in (9, 10):
        sent = [Sent(START_NS + part, [raw(part, "map", "odom")])]
        write_bare_mcap(folder / f"r_{part}.mcap", sent, ros=2)
    assert [item.log_ns for item in items_of(folder)] == [START_NS + 9, START_NS + 10]


def test_topics_keep_their_type_and_bytes(tmp_path: Path) -> None:
    """A message of ROS 1 becomes the same of ROS 2; the clock becomes that of tfbus."""
    needs.module("rosbags.typesys")
    from rosbags.rosbag1 import Writer

    from tests.recording.foreign_files import store_of

    store = store_of(1)
    types = store.types
    time = types["builtin_interfaces/msg/Time"](5, 7)
    header = types["std_msgs/msg/Header"](3, time, "base")
    point = types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    messages = {
        "/goal": types["geometry_msgs/msg/PointStamped"](header, point),
        "/clock": types["rosgraph_msgs/msg/Clock"](time),
    }
    with Writer(tmp_path / "r.bag") as bag:
        for at, (topic, message) in enumerate(messages.items()):
            name = message.__msgtype__
            connection = bag.add_connection(topic, name, typestore=store)
            bag.write(connection, START_NS + at, bytes(store.serialize_ros1(message, name)))
    goal, clock = messages_of(tmp_path / "r.bag")
    assert (goal.topic, goal.type_name) == ("goal", "geometry_msgs/msg/PointStamped")
    assert goal.values == {
        "header": {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "base"},
        "point": {"x": 1.0, "y": 2.0, "z": 3.0},
    }
    assert (clock.topic, clock.type_name, clock.values["stamp_ns"]) == (
        "clock",
        "Clock",
        5 * S + 7,
    )
    assert goal.encoded is not None
    definition, data = goal.encoded
    assert store_of(2).deserialize_cdr(data, definition.name).header.frame_id == "base"


def texts_in_bag(path: Path) -> Path:
    """A .bag with a map that is latched and a topic that is not."""
    from rosbags.rosbag1 import Writer

    store = store_of(1)
    text = store.types[TEXT]("x")
    with Writer(path) as bag:
        for topic, latching in (("/map", 1), ("/chatter", None)):
            connection = bag.add_connection(topic, TEXT, typestore=store, latching=latching)
            bag.write(connection, START_NS, bytes(store.serialize_ros1(text, TEXT)))
    return path


def texts_in_rosbag2(path: Path, storage: str) -> Path:
    """The same of rosbag2, the map transient local."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = store_of(2)
    text = store.types[TEXT]("x")
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        for topic, durability in (("/map", "TRANSIENT_LOCAL"), ("/chatter", "VOLATILE")):
            never = QosTime(9223372036, 854775807)
            qos = Qos(
                QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability[durability],
                never, never, QosLiveliness.AUTOMATIC, never, False,
            )  # fmt: skip
            connection = bag.add_connection(
                topic, TEXT, typestore=store, offered_qos_profiles=[qos]
            )
            bag.write(connection, START_NS, bytes(store.serialize_cdr(text, TEXT)))
    return path


@pytest.mark.parametrize("kind", ["bag", "SQLITE3", "MCAP"])
def test_a_topic_stays_retained(tmp_path: Path, kind: str) -> None:
    """What was latched, or transient local, is so in the recording, and other topics are not."""
    is_bag = kind == "bag"
    path = texts_in_bag(tmp_path / "r.bag") if is_bag else texts_in_rosbag2(tmp_path / "r", kind)
    assert {item.topic: item.retained for item in messages_of(path)} == {
        "map": True,
        "chatter": False,
    }


def test_files_of_rosbag2_without_definitions_are_read(tmp_path: Path) -> None:
    """Before Iron they had none: those of ROS's own types are known."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    from tests.recording.foreign_files import store_of

    store = store_of(2)
    name = "geometry_msgs/msg/Point"
    point = store.types[name](1.0, 2.0, 3.0)
    with Writer(tmp_path / "r", version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/goal", name, typestore=store)
        bag.write(connection, START_NS, bytes(store.serialize_cdr(point, name)))
    database = sqlite3.connect(tmp_path / "r" / "r.db3")
    database.execute("UPDATE schema SET schema_version = 3")
    database.commit()
    database.close()
    [goal] = messages_of(tmp_path / "r" / "r.db3")
    assert goal.values == {"x": 1.0, "y": 2.0, "z": 3.0}


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    """By topic, with the reason; the rest is imported."""
    writer_module = needs.module("mcap.writer")
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start("", "somebody else")
        for topic, encoding in (("/points", "flatbuffer"), ("/pose", "json"), ("/a b", "json")):
            channel = writer.register_channel(topic, encoding, 0)
            writer.add_message(channel, START_NS, b'{"x": 1}', START_NS)
        writer.add_message(2, START_NS + 1, b"{", START_NS)
        writer.finish()
    counts = Imported()
    assert [item.values for item in messages_of(path, counts=counts)] == [{"x": 1}]
    assert sorted(counts.left_out) == ["/a b", "/points"]
    assert "flatbuffer" in counts.left_out["/points"]
    assert counts.failed == {"/pose": 1}


@pytest.mark.parametrize(
    "statements",
    [
        "CREATE VIEW schema AS WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r)"
        " SELECT x AS schema_version FROM r WHERE x < 0",
        "ALTER TABLE messages ADD COLUMN more AS (zeroblob(900000000))",
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END",
    ],
)
@pytest.mark.parametrize("is_folder", [True, False])
def test_a_database_that_computes_what_it_holds_is_refused(
    tmp_path: Path, statements: str, is_folder: bool
) -> None:
    """rosbag2 writes plain tables: a view could be read for ever, and not be interrupted."""
    folder = write_rosbag2(tmp_path / "run", SENT, storage="SQLITE3")
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        if "VIEW schema" in statements:
            database.execute("DROP TABLE schema")
        database.execute(statements)
    database.close()
    with pytest.raises(DecodeError, match="is computed"), opened(folder if is_folder else file):
        pass


def test_a_packed_database_is_looked_at_as_any_other(tmp_path: Path) -> None:
    """A value that it computes is found once it is unpacked."""
    folder = write_rosbag2(tmp_path / "run", SENT, storage="SQLITE3", packed="FILE")
    file, plain = next(folder.glob("*.zstd")), tmp_path / "plain.db3"
    plain.write_bytes(zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read())
    with sqlite3.connect(plain) as database:
        database.execute("CREATE VIEW more AS SELECT 1")
    database.close()
    file.write_bytes(zstandard.compress(plain.read_bytes()))
    with pytest.raises(DecodeError, match=r"'more' .*computed"), opened(folder):
        pass


# What is packed, and what of it may be unpacked.
ZEROS = 24 * 2**20
MOST = 8 * 2**20


def zstd_of_zeros(*, is_sized: bool) -> bytes:
    """Megabytes in a few kB, with or without a word of their number before them."""
    if is_sized:
        return zstandard.compress(bytes(ZEROS))
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join(packer.compress(bytes(2**20)) for _ in range(ZEROS // 2**20)) + packer.flush()


def replaced(database_of: Path, data: bytes) -> None:
    """Put bytes into all messages of a database."""
    with sqlite3.connect(database_of) as database:
        database.execute("UPDATE messages SET data = ?", (data,))
    database.close()


@pytest.mark.parametrize("kind", ["sized", "not sized", "bz2", "lz4"])
def test_what_unpacks_to_gigabytes_is_refused(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunks of .bag and messages of rosbag2 unpack to 256 MiB at the most; here to less."""
    assert foreign_files.MOST_CHUNK_BYTES == 256 * 2**20
    monkeypatch.setattr(foreign_files, "MOST_CHUNK_BYTES", MOST)
    if "sized" in kind:
        path = write_rosbag2(tmp_path / "run", SENT, storage="SQLITE3", packed="MESSAGE")
        replaced(next(path.glob("*.db3")), zstd_of_zeros(is_sized=kind == "sized"))
    else:
        pack = {"bz2": bz2.compress, "lz4": lz4.frame.compress}[kind]
        zeros = bytes(ZEROS)
        # As the writer would: its chunk is these zeros.
        monkeypatch.setattr(f"rosbags.rosbag1.writer.{kind}_compress", lambda *_: pack(zeros))
        path = write_bag(tmp_path / "run.bag", SENT, compression=kind.upper())
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError, match="unpack"), opened(path) as bag_files:
            list(bag_files.messages())
        assert tracemalloc.get_traced_memory()[1] < ZEROS
    finally:
        tracemalloc.stop()


def test_a_file_that_unpacks_to_more_than_the_disk_has_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gigabyte stays free, and nothing of it is left behind."""
    folder = write_rosbag2(tmp_path / "run", SENT, storage="SQLITE3", packed="FILE")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    full = shutil.disk_usage(tmp_path)._replace(free=10**9)
    monkeypatch.setattr("tfbus.recording.records.disk_usage", lambda _: full)
    with pytest.raises(DecodeError, match="has no room: TMPDIR"), opened(folder):
        pass
    assert [each.name for each in tmp_path.iterdir()] == ["run"]


def test_metadata_that_is_nested_too_deeply_is_told(tmp_path: Path) -> None:
    """At once, whichever files are beside it."""
    folder = write_rosbag2(tmp_path / "run", SENT, storage="SQLITE3")
    (folder / "metadata.yaml").write_text("[" * 600)
    with pytest.raises(DecodeError, match="nested too deeply"), opened(folder):
        pass


def test_a_stamp_that_a_recording_cannot_hold_is_told(tmp_path: Path) -> None:
    """ROS 1 and Foxglove count seconds to 2106 at least, ROS 2 and recordings to 2038."""
    late_ns = 3_000_000_000 * S
    sent = [Sent(START_NS + at, [raw(at or late_ns, "map", "odom")]) for at in range(2)]
    counts = Imported()
    items = items_of(write_foxglove_json(tmp_path / "r.mcap", sent), counts=counts)
    assert [item.log_ns for item in items] == [START_NS + 1]
    assert counts.failed == {"/tf": 1}
    assert "2038" in counts.why_failed["/tf"]


def test_a_selection_is_imported(tmp_path: Path) -> None:
    """Streams by a regular expression, and transforms alone."""
    path = write_bag(tmp_path / "r.bag", SENT)
    items = transforms_of(path, selection=Selection(exclude="arm"))
    streams = {item.stream.name for item in items}
    assert streams == {"ros", "robot7/ros"}
    assert len(items_of(path, only_transforms=True)) == len(SENT)


@pytest.mark.parametrize("name", ["r.bag", "r.db3", "r.mcap"])
@pytest.mark.parametrize("content", [b"", b"not a recording at all\n", b"#ROSBAG V2.0\n" * 9])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    """With a DecodeError in one sentence, which names the file."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DecodeError, match=name):
        items_of(tmp_path / name)


def test_a_recording_of_tfbus_needs_no_import(tmp_path: Path) -> None:
    """Its streams would lose their names."""
    with RecordingWriter(tmp_path / "r.mcap"):
        pass
    with pytest.raises(DecodeError, match="needs no import"):
        items_of(tmp_path / "r.mcap")


def test_damaged_files_are_refused_wherever_they_are_cut(tmp_path: Path) -> None:
    """With a DecodeError, or with what is there."""
    for kind, write in WRITERS.items():
        folder = tmp_path / kind.replace(" ", "_")
        folder.mkdir()
        given = file = write(folder)
        if given.is_dir():
            [file] = [each for each in given.iterdir() if each.suffix != ".yaml"]
        data = file.read_bytes()
        for end in range(1, len(data), len(data) // examples(15)):
            file.write_bytes(data[:end])
            try:
                items_of(given)
            except DecodeError as error:
                assert "\n" not in str(error)


def test_a_folder_of_rosbag2_may_have_any_name(tmp_path: Path) -> None:
    """Also one that ends as a file of ROS 1 does."""
    folder = write_rosbag2(tmp_path / "r", SENT, storage="SQLITE3").rename(tmp_path / "run.bag")
    assert counted_items(folder) == counted_items(write_bag(tmp_path / "ros1.bag", SENT))


def counted_items(path: Path) -> int:
    """How many items of transforms a file, or a folder, has."""
    with opened(path) as files:
        items = imported(files.messages(), Imported())
        return sum(isinstance(item, TransformItem) for item in items)


def test_names_of_ros_1_are_such_as_others_read(tmp_path: Path) -> None:
    """A field `iTOW`, which ROS 2 does not allow, is `i_tow` for others, and `iTOW` for tfbus,
    whatever reads and writes the file.
    """
    typesys, rosbag1 = needs.module("rosbags.typesys"), needs.module("rosbags.rosbag1")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    name = "ublox_msgs/msg/Nav"
    store.register(
        typesys.get_types_from_msg("uint8 FIX=3\nuint32 iTOW\nuint32 i_tow\nint8[2] velN", name)
    )
    with rosbag1.Writer(tmp_path / "r.bag") as writer:
        connection = writer.add_connection("/nav", name, typestore=store)
        message = store.types[name](5, 6, needs.module("numpy").array([1, 2], "int8"))
        writer.write(connection, START_NS, store.serialize_ros1(message, name))
    path = tmp_path / "run.mcap"
    with opened(tmp_path / "r.bag") as files, RecordingWriter(path) as recording:
        for item in imported(files.messages(), Imported()):
            recording.write(item)
    with RecordingReader(path) as reader:
        [found] = [item for item in reader.items() if isinstance(item, TopicItem)]
    assert found.values == {"iTOW": 5, "i_tow": 6, "velN": [1, 2]}
    assert found.encoded is not None
    definition, data = found.encoded
    others = typesys.get_typestore(typesys.Stores.EMPTY)
    others.register(typesys.get_types_from_msg(definition.text, name))
    read = others.deserialize_cdr(data, name)
    assert (read.i_tow_2, read.i_tow, read.vel_n.tolist(), read.FIX) == (5, 6, [1, 2], 3)


def test_the_metadata_of_a_folder_is_read_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It may have megabytes, for which YAML takes long."""
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")
    (tmp_path / "a_0.mcap").touch()
    reads: list[str] = []
    load = foreign_files.yaml.safe_load
    monkeypatch.setattr(
        foreign_files.yaml, "safe_load", lambda text: (reads.append(text), load(text))[1]
    )
    with pytest.raises(DecodeError), opened(tmp_path):
        pass
    assert len(reads) == 1


@pytest.mark.parametrize("clock", [b"{}", b'{"clock": 5}', b'{"clock": {"sec": 1.5}}'])
def test_a_clock_with_fields_of_its_own_is_left_out(clock: bytes) -> None:
    """It is counted, and the others are imported."""
    channel = ForeignChannel("/clock", "rosgraph_msgs/msg/Clock", "json")
    counts = Imported()
    sent = [clock, b'{"clock": {"sec": 1, "nanosec": 2}}']
    (item,) = imported([ForeignMessage(START_NS, channel, data) for data in sent], counts)
    assert isinstance(item, TopicItem) and item.values["stamp_ns"] == S + 2
    assert counts.failed == {"/clock": 1}
