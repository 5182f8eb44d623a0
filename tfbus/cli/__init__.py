"""The `tfbus` command: finds the subcommand and imports only that one.

Subcommands are the tools listed here, and every node of the entry-point group `tfbus.nodes`, ours
and other packages'.

A command or an option that is not there is answered with a near name, all names, or a hint.
"""

import errno
import os
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from typing import Any

import click

from tfbus.base.standard_error import for_stderr
from tfbus.base.wording import did_you_mean
from tfbus.cli.output import sentence

_NO_QOS = "not needed: there is no QoS"
_NO_DAEMON = "not needed: there is no daemon, each command asks the nodes"
_ALL_LISTED = "not needed: topics, services and parameters are never hidden"

# Options of many commands of ros2.
_OF_MANY = {
    "--qos-profile": _NO_QOS,
    "--qos-depth": _NO_QOS,
    "--qos-history": _NO_QOS,
    "--qos-reliability": _NO_QOS,
    "--qos-durability": "not needed: static transforms and retained topics reach late subscribers",
    "--qos-liveliness": _NO_QOS,
    "--qos-liveliness-lease-duration-seconds": _NO_QOS,
    "--no-daemon": _NO_DAEMON,
    "--spin-time": _NO_DAEMON,
    "--include-hidden": _ALL_LISTED,
    "--include-hidden-topics": _ALL_LISTED,
    "--include-hidden-services": _ALL_LISTED,
    "--include-hidden-interfaces": _ALL_LISTED,
    "--include-hidden-nodes": "use tfbus node list --all for names that start with _",
}


_ERROR = "Error: "

# More characters than a sentence has.
_WHOLE = 1000


class Answering(click.Command):
    """A command that answers options of ROS that it does not have: by its `hints`, or the hints of
    many commands.
    """

    def __init__(self, *args: Any, hints: Mapping[str, str] | None = None, **given: Any) -> None:
        super().__init__(*args, **given)
        self.hints = {**_OF_MANY, **(hints or {})}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click's own; a usage error with the hint for an option that has one."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            hint = self.hints.get(error.option_name)
            if hint is None:
                raise
            ctx.fail(f"there is no option {error.option_name}: {hint}")


class Verbs(click.Group):
    """A group such as `tfbus topic`; `hints` answer commands of ROS that it does not have."""

    command_class = Answering

    def __init__(self, *args: Any, hints: Mapping[str, str] | None = None, **given: Any) -> None:
        super().__init__(*args, **given)
        self.hints = hints or {}

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's own; a usage error with a hint for an unknown command."""
        name = args[0]
        is_known = name.startswith("-") or self.get_command(ctx, name) is not None
        if not is_known and not ctx.resilient_parsing:
            ctx.fail(f"there is no command {name!r}{self._hint(ctx, args)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """As click's own, but the first sentence of each command whole."""
        found = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        rows = [(name, each.get_short_help_str(_WHOLE)) for name, each in found.items() if each]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _hint(self, ctx: click.Context, args: list[str]) -> str:
        name = args[0]
        if name in self.hints:
            return f"; {self.hints[name]}"
        return did_you_mean(name, self.list_commands(ctx))


# The errors of a write to a full disk.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

NODE_GROUP = "tfbus.nodes"

# Set by the completion script of a shell, which `tfbus` then answers.
_COMPLETE_VARIABLE = "_TFBUS_COMPLETE"

# One line each, repeated here because importing all subcommands for `--help` is slow; a test
# compares them.
TOOLS = {
    "bag": "Record a bus, replay it, and cut, convert and repair recordings.",
    "call": "Call a service or an action, and print its answers.",
    "completion": "Print the script that completes tfbus in your shell.",
    "create": "Create a small package with a node, a launch file and a test.",
    "doctor": "Check this host and the bus, and say what to fix; exits with 1 on a failure.",
    "fleet": "Show a fleet at a glance: which robots are there, gone, missing or in trouble.",
    "frames": "Show the tree of frames, its publishers, and what is wrong with it.",
    "keys": "Make identities for a closed bus: who may do what, encrypted.",
    "launch": "Start the processes of a launch file, and stop them together.",
    "monitor": "Measure rate, delay and order of transforms: all, or those between two frames.",
    "node": "List nodes, or show one.",
    "param": "List, read, set, save and load the parameters of nodes.",
    "plot": "Plot position, orientation and speed of SOURCE seen from TARGET.",
    "router": "Run a Zenoh router, which connects networks.",
    "service": "List, show and call services; install a launch file as a service of this machine.",
    "top": "Watch nodes, streams, frames and topics on one screen.",
    "topic": "List, show, print, measure and publish topics.",
    "why": "Explain, edge by edge, why SOURCE cannot be seen from TARGET, and what to do.",
}

NODES = {
    "broadcaster": "Broadcast the frames of a turtle and its drone.",
    "carrot": "Broadcast a frame fixed to another one, or circling it.",
    "clock": "Publish the simulated time for nodes with --sim-time.",
    "draw_square": "Drive a turtle along a square.",
    "echo": "Print the pose of the frame SOURCE seen from the frame TARGET.",
    "follow": "Spawn a turtle that follows a frame.",
    "foxglove": "Show the bus, or a recording, in Foxglove.",
    "joints": "Publish joint states without a robot: by sliders, sweeps, random places, files.",
    "mimic": "Copy the speeds of input/pose to output/cmd_vel.",
    "robot_state": "Publish the frames of a robot from its URDF and from joint states.",
    "ros1": "Bridge to ROS 1: transforms, static ones, the clock, and topics that both know.",
    "ros2": "Bridge to ROS 2: transforms, static ones, the clock, and topics that both know.",
    "share": "Show frames of one robot to others.",
    "simulator": "Simulate turtles to drive and to watch (turtlesim).",
    "static": "Publish static transforms.",
    "teleop": "Drive a turtle with the keyboard.",
    "view": "Show all frames in a browser, of the bus or with --bag of a recording.",
}


# The commands by their purpose, the most needed in front.
JOBS = {
    "Begin here": ("launch", "view", "frames", "echo", "doctor"),
    "Look into it": ("top", "monitor", "why", "plot", "node", "topic", "service", "param", "call"),
    "Publish frames": ("static", "robot_state", "joints", "clock"),
    "Record and replay": ("bag",),
    "Connect networks, robots and other programs": (
        "router",
        "share",
        "fleet",
        "ros1",
        "ros2",
        "foxglove",
        "keys",
    ),
    "Write a node": ("create", "completion"),
    "Turtles, for the tutorial": (
        "simulator",
        "teleop",
        "draw_square",
        "broadcaster",
        "carrot",
        "follow",
        "mimic",
    ),
}


class Commands(Verbs):
    """Subcommands by name, imported when one is called."""

    def main(self, args: Any = None, prog_name: Any = None, *_: Any, **given: Any) -> Any:
        """As click's own; `completion` answers a shell's completion."""
        if _COMPLETE_VARIABLE in os.environ:
            import_module("tfbus.cli.completion")
        return super().main(args, prog_name, _COMPLETE_VARIABLE, **given)

    def invoke(self, ctx: click.Context) -> Any:
        """As click's own, but Ctrl-C ends a tool without a message, and an error is one line that
        can be printed, whatever it quotes.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise SystemExit(128 + signal.SIGINT) from None
        except OSError as error:
            if error.errno not in _FULL:
                raise
            # Python writes the rest of its buffers at its end, and would fail once more.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            raise click.ClickException(f"the output cannot be written: {error.strerror}") from error
        except click.exceptions.NoArgsIsHelpError:
            raise  # its message is the whole help
        except click.ClickException as error:
            vars(error)["message"] = sentence(error.message)
            # click puts its word in front.
            told = for_stderr(f"{_ERROR}{error.format_message()}").removeprefix(_ERROR)
            vars(error)["format_message"] = lambda: told
            raise

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[Any]:
        """The names of subcommands that start with the text, without importing any."""
        from click.shell_completion import CompletionItem  # only while completing

        helps = {**dict.fromkeys(self.list_commands(ctx)), **TOOLS, **NODES}
        return [
            *(
                CompletionItem(name, help=text)
                for name, text in sorted(helps.items())
                if name.startswith(incomplete)
            ),
            *click.Command.shell_complete(self, ctx, incomplete),
        ]

    def _hint(self, ctx: click.Context, args: list[str]) -> str:
        if args[0] in ("run", "rosrun") and len(args) > 2:  # ros2 run PACKAGE EXECUTABLE
            ours = CALLED_IN_ROS.get(args[2], args[2])
            if ours != args[2] or ours in self.list_commands(ctx):
                return f"; use: tfbus {ours}"
        two_words = " ".join(args[:2])
        if two_words in self.hints:
            return f"; {self.hints[two_words]}"
        return super()._hint(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*TOOLS, *NODES, *entry_points()})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name in TOOLS:
            return _tool(name)
        if name in NODES:
            return _as_command(name, import_module(f"tfbus.nodes.{name}").main)
        found = entry_points().get(name)
        return _as_command(name, found.load()) if found else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        own = NODES.keys()
        others = {
            name: f"A node of the package {point.dist.name if point.dist else '?'}."
            for name, point in entry_points().items()
            if name not in own
        }
        texts = {**TOOLS, **NODES}
        jobs = {job: {name: texts[name] for name in names} for job, names in JOBS.items()}
        for title, commands in {**jobs, "Nodes of other packages": others}.items():
            if commands:
                with formatter.section(title):
                    formatter.write_dl(list(commands.items()))


# Names in ROS of commands here.
CALLED_IN_ROS = {
    "action": "call",
    "action info": "service info",
    "action list": "service list",
    "action type": "service type",
    "check_urdf": "robot_state",
    "foxglove_bridge": "foxglove",
    "interface": "topic show, or tfbus service show",
    "joint_state_publisher": "joints",
    "joint_state_publisher_gui": "joints",
    "msg": "topic show",
    "pkg": "create",
    "robot_state_publisher": "robot_state",
    "rosbag": "bag",
    "roslaunch": "launch",
    "rosmsg": "topic show",
    "rosnode": "node",
    "rosparam": "param",
    "rosservice": "service",
    "rossrv": "service show",
    "rostopic": "topic",
    "roswtf": "doctor",
    "rqt": "top, tfbus plot, tfbus view or tfbus foxglove",
    "rqt_bag": "bag info, tfbus view --bag, or tfbus foxglove --bag",
    "rqt_graph": "node list, or tfbus top",
    "rqt_plot": "plot",
    "rqt_reconfigure": "param set",
    "rqt_tf_tree": "frames",
    "rqt_top": "top",
    "rqt_topic": "top",
    "rviz": "view",
    "rviz2": "view",
    "security": "keys",
    "srv": "service show",
    "static_transform_publisher": "static",
    "tf2_echo": "echo",
    "tf2_monitor": "monitor",
    "tf_echo": "echo",
    "tf_monitor": "monitor",
    "turtle_teleop_key": "teleop",
    "turtlesim_node": "simulator",
    "view_frames": "frames",
    "wtf": "doctor",
}

# Commands of `tfbus bag` are looked for without it, too.
_OF_BAG = {
    name: f"use: tfbus bag {name}"
    for name in ("cut", "export", "filter", "import", "info", "merge", "play", "record", "recover")
}
_RUN = "a node is a command itself, as in: tfbus simulator"

# Commands of ROS that have no counterpart.
NOT_NEEDED_FROM_ROS = {
    "component": "tfbus has none, since each node is a process: tfbus launch starts several",
    "daemon": "tfbus has none, since each command asks the nodes itself: nothing to start or stop",
    "lifecycle": "tfbus has none, since a node is active from its start to its end: tfbus node "
    "list shows those that run",
    "multicast": "tfbus has no test of its own for it: tfbus doctor says whether multicast works",
    "roscore": "tfbus has no master: start a node, as in tfbus simulator",
    "rosrun": _RUN,
    "rqt_console": "tfbus has none, since nodes log to their terminals: tfbus launch shows the "
    "logs of all it started",
    "run": _RUN,
    "test": "tfbus has none: pytest runs the tests of a package that tfbus create wrote",
}


@click.command(
    cls=Commands,
    hints={theirs: f"use: tfbus {ours}" for theirs, ours in CALLED_IN_ROS.items()}
    | NOT_NEEDED_FROM_ROS
    | _OF_BAG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="To get started: tfbus launch turtle",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, is_given: _print_version(context) if is_given else None,
    help="Show the version and exit.",
)
@click.option(
    "--secure",
    type=click.Path(),
    metavar="DIR",
    help="Join a closed bus by the identity in DIR, in any command (tfbus keys).",
)
def main(secure: str | None) -> None:
    """Coordinate frames for distributed robots, without ROS."""
    if secure:
        # Also for the processes that a command starts.
        os.environ["TFBUS_SECURE"] = os.path.abspath(secure)
    _keep_freed_memory()


# From glibc's <malloc.h>.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT, _LARGEST_KEPT = 64 * 1024 * 1024, 32 * 1024 * 1024


def _keep_freed_memory() -> None:
    """Let a process through which large messages pass keep up to 64 MB that it has freed, for the
    next message; in C libraries other than glibc nothing changes.

    By default glibc gives the memory of a large message back to the system, which fills that of the
    next one with zeros, page by page: that takes as long as to copy it several times.
    """
    import ctypes  # programs without a bus do not need it

    with suppress(OSError, AttributeError, TypeError):  # another library
        change = ctypes.CDLL(None).mallopt
        change(_MMAP_THRESHOLD, _LARGEST_KEPT)
        change(_TRIM_THRESHOLD, _KEPT)


def _print_version(context: click.Context) -> None:
    from tfbus.base.installation import SLOWER, version_and_origin, why_interpreted
    from tfbus.buffer.buffer import COMPILED

    click.echo(f"tfbus {version_and_origin()}")
    if not COMPILED:
        click.echo(why_interpreted() or f"The buffer is interpreted: {SLOWER}.")
    context.exit()


def entry_points() -> dict[str, Any]:
    """The nodes of the entry-point group by name: ours and other packages'."""
    from importlib import metadata  # 10 ms that most commands do not need

    return {point.name: point for point in metadata.entry_points(group=NODE_GROUP)}


def _tool(name: str) -> click.Command:
    command: click.Command = import_module(f"tfbus.cli.{name}").command
    return command


def _as_command(name: str, target: Callable[..., Any]) -> click.Command:
    """A node's entry point as a subcommand: a click command, or a function of a list of
    arguments.
    """
    if isinstance(target, click.Command):
        return target

    @click.command(
        name,
        context_settings={"ignore_unknown_options": True, "help_option_names": []},
        add_help_option=False,
    )
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def command(arguments: tuple[str, ...]) -> None:
        raise SystemExit(target(list(arguments)))

    return command
