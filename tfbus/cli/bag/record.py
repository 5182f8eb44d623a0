"""`tfbus bag record`: everything on the bus, or a part of it, into a file."""

import os
from typing import Any

import click

from tfbus.base.errors import TfbusError
from tfbus.base.installation import install_command
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Answering
from tfbus.cli.bag.files import CALLED_IN_ROS, NO_SERVICES, SelectionOptions, selecting
from tfbus.command.options import Several, bus_options
from tfbus.command.types import POSITIVE, ByteSize, Number, SpanOrSize, TopicName

# A file begins with the state in force; smaller ones would be little else.
_LEAST_FILE_BYTES = 100_000
_LEAST_KEPT_BYTES = 1_000_000
_LEAST_CACHE_BYTES = 1_000_000
_NO_CACHE = "messages are always written from memory, within 1 s; omit the option for 100MB"
_NO_LIMIT = "omit the option for no limit"

# Options of `ros2 bag record` that are not needed here, or have another name.
_COMPRESSION = "use --compression zstd, lz4 or none"
_NO_THREADS = "not needed: compression takes part of one thread; --compression none takes none"

_OF_RECORD = {
    "--all-services": NO_SERVICES,
    "--all-actions": NO_SERVICES,
    "--topic-types": "use --topics with what tfbus topic find TYPE prints",
    "--exclude-topic-types": "use --exclude-topics with what tfbus topic find TYPE prints",
    "--static-topics-path": "use --topics; they need not be there yet",
    "--include-unpublished-topics": "not needed: topics that nodes only subscribe to are recorded",
    "--include-hidden-topics": "not needed: no topic is hidden",
    "--ignore-leaf-topics": "use --exclude-topics",
    "--no-discovery": "use --topics for those that are there now",
    "--polling-interval": "not needed: nodes tell of their topics",
    "-p": "not needed: nodes tell of their topics",
    "--snapshot-mode": "use --snapshot SECONDS",
    "--max-cache-duration": "use --snapshot SECONDS",
    "--use-sim-time": "not needed: stamps are recorded as they are, and the topic clock",
    "--repeat-transient-local": "not needed: static transforms are in each file, every 5 s",
    "--compression-mode": _COMPRESSION,
    "--storage-preset-profile": _COMPRESSION,
    "--storage-config-file": _COMPRESSION,
    "--compression-queue-size": _NO_THREADS,
    "--compression-threads": _NO_THREADS,
    "--compression-threads-priority": _NO_THREADS,
    "--stats_max_publishing_rate": "what is lost is in the status line, the log and the file",
}


@click.command(
    "record",
    cls=Answering,
    hints=CALLED_IN_ROS | _OF_RECORD,
    epilog="Examples: tfbus bag record; tfbus bag record -o run --max-size 500MB; tfbus bag record "
    "--topics turtle1/pose tf tf_static; tfbus bag record --snapshot 30 --on 'gone base_link'",
)
@click.argument("more_topics", metavar="[TOPIC]...", type=TopicName(), nargs=-1)
@selecting
@click.option(
    "-a",
    "--all",
    "--all-topics",
    "wants_all",
    is_flag=True,
    hidden=True,
    help="Record everything, the default.",
)
@click.option(
    "--fleet", is_flag=True, help="Record the namespaces below too: all robots of a fleet."
)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="The file to write, or a folder for it (default tfbus_<date>-<time>.mcap).",
)
@click.option(
    "-b",
    "--max-size",
    "--max-bag-size",
    "max_bytes",
    type=ByteSize(least=_LEAST_FILE_BYTES, zero=_NO_LIMIT),
    metavar="SIZE",
    help="Go on in a new file after this size, such as 500MB.",
)
@click.option(
    "-d",
    "--max-duration",
    "--max-bag-duration",
    "max_s",
    type=Number(least=1.0, most=1e9, zero=_NO_LIMIT),
    metavar="S",
    help="Go on in a new file after this many seconds.",
)
@click.option(
    "--max-files",
    "--max-bag-files",
    "most_files",
    type=click.IntRange(min=1),
    metavar="N",
    help="Keep the last N files or snapshots, and delete older ones of this recording.",
)
@click.option(
    "--keep",
    type=SpanOrSize(least_s=10.0, least_bytes=_LEAST_KEPT_BYTES),
    metavar="SPAN|SIZE",
    help="Keep the last SPAN (15min) or SIZE (2GB) in a folder (-o), also over restarts, and serve "
    "it: recorders that were out of reach fill their gaps from it.",
)
@click.option(
    "--compression",
    "--compression-format",
    type=click.Choice(("zstd", "lz4", "none")),
    default="zstd",
    show_default=True,
    help="How to compress; lz4 takes half the time.",
)
@click.option(
    "--snapshot",
    "snapshot_s",
    type=POSITIVE,
    metavar="S",
    help="Hold the last S seconds in memory, and write them when asked.",
)
@click.option(
    "--on",
    "conditions",
    multiple=True,
    metavar="EVENT",
    help="With --snapshot, also write when this happens: 'gone FRAME' or 'conflict FRAME'; "
    "without FRAME any. Repeatable.",
)
@click.option(
    "--max-cache-size",
    "cache_bytes",
    type=ByteSize(least=_LEAST_CACHE_BYTES, zero=_NO_CACHE),
    metavar="SIZE",
    help="Memory for messages that wait to be written (default 100MB), or for the snapshot "
    "(default 500MB).",
)
@click.option(
    "--history",
    "with_history",
    is_flag=True,
    help="Begin with what publishers still hold of the last seconds.",
)
@click.option(
    "--start-paused", "starts_paused", is_flag=True, help="Record nothing until it is resumed."
)
@click.option(
    "--disable-keyboard-controls", "no_keys", is_flag=True, help="Take no keys in a terminal."
)
@click.option(
    "--custom-data",
    cls=Several,
    multiple=True,
    metavar="KEY=VALUE...",
    help="Note these in the file, which bag info shows.",
)
@click.option("-s", "--storage", type=click.Choice(("mcap",)), hidden=True, expose_value=False)
@click.option(
    "-f",
    "--serialization-format",
    type=click.Choice(("cdr",)),
    hidden=True,
    expose_value=False,
    help="Messages are in CDR.",
)
@click.option(
    "--node-name",
    "--name",
    metavar="NAME",
    help="The name of its node, and so of its services (default recorder).",
)
@bus_options("recorder")
def command(
    settings: NodeSettings,
    more_topics: tuple[str, ...],
    asked: SelectionOptions,
    wants_all: bool,
    fleet: bool,
    output: str | None,
    max_bytes: int | None,
    max_s: float | None,
    most_files: int | None,
    keep: tuple[float | None, int | None] | None,
    compression: Any,
    snapshot_s: float | None,
    conditions: tuple[str, ...],
    cache_bytes: int | None,
    with_history: bool,
    starts_paused: bool,
    no_keys: bool,
    custom_data: tuple[str, ...],
    node_name: str | None,
) -> None:
    """Record the bus into an MCAP file: transforms, topics, and who was there.

    Everything is recorded, unless topics, streams, frames or a regular expression say what. Names
    are relative to the namespace. The file is never one that exists. Data that has come is on the
    disk within a second, so a crash loses at most that second; with --history, what comes before
    the publishers have answered (at most 6 s) is written after that. Ctrl-C ends the recording.

    What a recorder with --keep in a robot has recorded while the robot was out of reach is filled
    in once it is back, behind what is sent then.

    In a terminal the space key pauses, s begins a new file (or writes the snapshot), q ends. The
    services recorder/pause, resume, split, snapshot and stop do the same.
    """
    if wants_all and (asked.is_narrow or more_topics):
        raise click.UsageError(
            "-a records everything: leave it out, or leave out --topics, --streams, --frames and "
            "--regex"
        )
    if most_files is not None and not (max_bytes or max_s or snapshot_s):
        raise click.UsageError(
            "--max-files keeps the last files: give --max-size, --max-duration or --snapshot"
        )
    if keep is not None:
        if max_bytes or max_s or most_files or snapshot_s is not None:
            raise click.UsageError(
                "--keep says which files stay: leave out --max-size, --max-duration, --max-files "
                "and --snapshot"
            )
        if output is None or output.endswith(".mcap"):
            raise click.UsageError("--keep has a folder of files: give -o FOLDER")
        output = os.path.join(output, "")
    if snapshot_s is None and conditions:
        raise click.UsageError("--on writes a snapshot: give --snapshot SECONDS too")
    if snapshot_s is not None and (max_bytes or max_s):
        raise click.UsageError(
            "each snapshot is a file of its own: --max-size and --max-duration are for recordings "
            "without --snapshot"
        )
    try:
        import mcap.writer  # noqa: F401 - only whether it is installed
    except ImportError as error:
        raise TfbusError(
            f"recordings need mcap, which is not installed: {install_command('bag')}"
        ) from error
    # numpy and Zenoh, which `--help` does not need.
    from tfbus.bag.keeping import Keep, Splits
    from tfbus.bag.recorder import SnapshotCondition
    from tfbus.cli.bag.record_run import RecordPlan, checked, free_path, pairs_of, record

    try:
        settings = (
            settings.renamed(node_name) if node_name else settings.named_by_default("recorder")
        )
        plan = RecordPlan(
            selection=checked(asked.selection(settings.namespace, more_topics)),
            everywhere=fleet,
            splits=Splits(max_bytes, max_s) if keep is None else Keep(*keep).splits(),
            compression=compression,
            cache_bytes=cache_bytes,
            snapshot_s=snapshot_s,
            conditions=tuple(map(SnapshotCondition.parse, conditions)),
            with_history=with_history,
            starts_paused=starts_paused,
            has_keys=not no_keys,
            most_files=most_files,
            keep=None if keep is None else Keep(*keep),
            custom_data=pairs_of(custom_data),
            path=free_path(output),  # the last, as it may make a folder
        )
    except TfbusError as error:
        raise click.UsageError(str(error)) from error
    if failure := record(settings, plan):
        raise click.ClickException(failure)
