"""`tfbus static`: publish static transforms, as static_transform_publisher does.

Try it: tfbus static world camera --x 1 --yaw 0.5
"""

from logging import Logger
from pathlib import Path

import click

from tfbus import (
    FrameName,
    Node,
    NodeSettings,
    Number,
    StaticTransformBroadcaster,
    TransformStamped,
    node_options,
)
from tfbus.command.types import own_name

from .static_edge import EdgeMistake, in_new_form, make_edge


class _Static(click.Command):
    """Answers the form without flags of ROS with the same in flags."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if line := in_new_form(args):
            raise click.UsageError(f"give the numbers by flags, as in: {line}", ctx)
        return super().parse_args(ctx, args)


@click.command(
    cls=_Static,
    epilog="Examples: tfbus static world camera --x 1 --yaw 0.5; tfbus static --file edges.yaml",
)
@click.argument("frame_id", required=False, shell_complete=FrameName().shell_complete)
@click.argument("child_frame_id", required=False, shell_complete=FrameName().shell_complete)
@click.option(
    "--frame-id", "frame_option", metavar="FRAME", help="The parent, instead of the first argument."
)
@click.option(
    "--child-frame-id",
    "child_option",
    metavar="FRAME",
    help="The child, instead of the second argument.",
)
@click.option("--x", type=Number(), help="Metres (default 0).")
@click.option("--y", type=Number(), help="Metres (default 0).")
@click.option("--z", type=Number(), help="Metres (default 0).")
@click.option("--roll", type=Number(), help="Radians about x, applied first (default 0).")
@click.option("--pitch", type=Number(), help="Radians about y, applied second (default 0).")
@click.option("--yaw", type=Number(), help="Radians about z, applied last (default 0).")
@click.option("--qx", type=Number(), help="Quaternion, instead of roll, pitch, yaw (default 0).")
@click.option("--qy", type=Number(), help="Quaternion (default 0).")
@click.option("--qz", type=Number(), help="Quaternion (default 0).")
@click.option("--qw", type=Number(), help="Quaternion (default 1).")
@click.option("--deg", is_flag=True, help="Angles are in degrees.")
@click.option(
    "--file",
    "path",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="A YAML list of edges; keys are these flags: frame_id, child_frame_id, x, yaw ...",
)
@node_options(lambda: own_name("static"))
def main(
    settings: NodeSettings,
    frame_id: str | None,
    child_frame_id: str | None,
    frame_option: str | None,
    child_option: str | None,
    deg: bool,
    path: Path | None,
    **numbers: float | None,
) -> None:
    """Publish static transforms."""
    given = {name: value for name, value in numbers.items() if value is not None}
    frames = _frames(frame_id, child_frame_id, frame_option, child_option)
    if path is not None:
        edges = _edges_of_file(path, deg, alone=not given and not frames)
    else:
        edges = [_edge(frames, given, deg)]
    _publish(settings, edges)


def _publish(settings: NodeSettings, edges: list[TransformStamped]) -> None:
    with Node.from_settings(settings) as node:
        StaticTransformBroadcaster(node).send_transform(
            TransformStamped(node.now_ns(), edge.frame_id, edge.child_frame_id, edge.transform)
            for edge in edges
        )
        for edge in edges:
            _announce(edge, node.log)
        node.spin()


def _announce(edge: TransformStamped, log: Logger) -> None:
    """Log the four lines that static_transform_publisher logs of an edge."""
    log.info(
        "Spinning until stopped - publishing transform\n"
        "translation: ('%.6f', '%.6f', '%.6f')\n"
        "rotation: ('%.6f', '%.6f', '%.6f', '%.6f')\n"
        "from '%s' to '%s'",
        *edge.transform.xyz,
        *edge.transform.quat_xyzw,
        edge.frame_id,
        edge.child_frame_id,
    )


def _frames(
    parent: str | None, child: str | None, parent_option: str | None, child_option: str | None
) -> dict[str, str]:
    """The names that were given, as arguments or by flags, not both."""
    arguments, options = (parent, child), (parent_option, child_option)
    if any(name is not None for name in arguments) and any(name is not None for name in options):
        raise click.UsageError("name the frames as arguments or by flags, not both")
    names = options if parent is None else arguments
    pairs = zip(("frame_id", "child_frame_id"), names, strict=True)
    return {field: name for field, name in pairs if name is not None}


def _edge(frames: dict[str, str], numbers: dict[str, float], degrees: bool) -> TransformStamped:
    try:
        return make_edge(frames, numbers, degrees=degrees)
    except EdgeMistake as mistake:
        flag = f"--{mistake.field.replace('_', '-')}"
        raise click.UsageError(f"{flag}: {mistake.reason}") from mistake


def _edges_of_file(path: Path, degrees: bool, *, alone: bool) -> list[TransformStamped]:
    if not alone:
        raise click.UsageError("--file cannot be combined with frames or numbers")
    from .static_file import read_edges  # YAML, which one edge does not need

    return read_edges(path, degrees=degrees)


if __name__ == "__main__":
    main()
