"""The same with the libraries mcap and mcap-ros2-support."""

from collections.abc import Iterable
from statistics import median

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from benchmarks.bus.place import say
from benchmarks.recordings import robot
from benchmarks.recordings.cost import cpu_s, say_cost
from benchmarks.recordings.lists import arrays
from tfbus.ros.definitions import TF_MESSAGE


def make(path: str, count: int) -> None:
    """A file as its own writer makes it by default."""
    _write(path, robot.messages(count), "zstd")
    say("made")


def write(folder: str, count: int, compression: str) -> None:
    """Bytes of ROS, made before, into a file."""
    few, all_of_them = robot.messages(10), robot.messages(count)
    say_cost(
        lambda: _write(f"{folder}/all.mcap", all_of_them, compression),
        lambda: _write(f"{folder}/few.mcap", few, compression),
    )


def _write(path: str, messages: Iterable[tuple[int, bytes]], compression: str) -> None:
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType[compression.upper()])
        writer.start("ros2")
        schema = writer.register_schema(TF_MESSAGE.name, "ros2msg", TF_MESSAGE.text.encode())
        channel = writer.register_channel("/tf", "cdr", schema)
        for sequence, (log_ns, data) in enumerate(messages):
            writer.add_message(channel, log_ns, data, log_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped


def read(path: str) -> None:
    """All transforms as arrays."""
    say_cost(lambda: _read(path, None, None), lambda: _read(path, None, robot.log_ns(10)))


def _read(path: str, from_ns: int | None, to_ns: int | None) -> int:
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return arrays(
            decoded.decoded_message
            for decoded in reader.iter_decoded_messages(starting_at=from_ns, ending_before=to_ns)
        )


def open_it(path: str) -> None:
    """Open a file, and read its summary."""

    def job() -> None:
        with open(path, "rb") as file:
            summary = make_reader(file).get_summary()
            assert summary is not None
            assert summary.statistics is not None
            assert summary.statistics.message_end_time and summary.channels

    say_cost(job)


def seek(path: str) -> None:
    """A tenth of a second in the middle as arrays: the median of many."""
    middle_ns = robot.log_ns(robot.HOUR // 2)
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        costs = []
        for step in range(20):
            from_ns = middle_ns + step * 1_000_000_000

            def job(from_ns: int = from_ns) -> None:
                found = reader.iter_decoded_messages(
                    starting_at=from_ns, ending_before=from_ns + 100_000_000
                )
                assert arrays(one.decoded_message for one in found) >= 5 * robot.FRAMES

            costs.append(cpu_s(job))
    say(median(costs))
