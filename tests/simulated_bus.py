"""A bus for tests on a simulated network: as `live_bus.Bus`, in virtual time."""

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from importlib import import_module
from signal import SIGINT
from typing import Any, Never
from unittest.mock import patch

from tests.buses import DEADLINE_S, eventually
from tfbus import Node, NodeSettings
from tfbus.base.addresses import Interface
from tfbus.testing.network import Network
from tfbus.testing.processes import Process
from tfbus.testing.programs import Program


class Bus:
    """Processes on one host of a simulated network; the nodes of the test are in one of them.

    Of a node that is to be killed or stopped: `with bus.network.process("outside", "robot")`.
    """

    def __init__(self, network: Network, host: str = "") -> None:
        """A bus on the host of the test, or on another one."""
        self.network = network
        self.host = host or "outside"
        self._process: Process | None = None
        if host:
            with network.process(host, "test") as self._process:
                pass
        # How to join it, as the real one has.
        self.options: list[str] = []
        self.env = {
            **{key: value for key, value in os.environ.items() if not key.startswith("TFBUS_")},
            "COLUMNS": "80",
        }
        self._nodes: list[Node] = []

    def node(self, name: str, *, namespace: str = "", **given: Any) -> Node:
        """A node in the process of the test; what is given are fields of NodeSettings."""
        with self.network.within(self._process) if self._process else nullcontext():
            node = Node(settings=NodeSettings(name, namespace=namespace, **given))
        self._nodes.append(node)
        return node

    def start(self, *arguments: str, env: dict[str, str] | None = None, **given: Any) -> Program:
        """`tfbus ARGUMENTS` as a process that goes on."""
        return self.start_python("tfbus.__main__", *arguments, env=env, **given)

    def start_python(
        self,
        module: str,
        *arguments: str,
        env: dict[str, str] | None = None,
        **given: Any,
    ) -> Program:
        """`python -m MODULE ARGUMENTS` as a process that goes on; its `main` takes none."""
        return self.start_main(
            import_module(module).main,
            *arguments,
            name=module.removesuffix(".__main__"),
            env=env,
            **given,
        )

    def start_main(
        self,
        main: Callable[[], object],
        *arguments: str,
        name: str = "",
        env: dict[str, str] | None = None,
        **given: Any,
    ) -> Program:
        """A program that is a function, as a process that goes on; the rest as Network.program."""
        return self.network.program(
            self.host,
            main,
            *arguments,
            name=name,
            env={**self.env, **(env or {})},
            **given,
        )

    def run(
        self, *arguments: str, env: dict[str, str] | None = None, stdin: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """`tfbus ARGUMENTS`, run to its end."""
        program = self.start_python("tfbus.__main__", *arguments, env=env, stdin=stdin)
        code = program.wait(timeout_s=DEADLINE_S)
        return subprocess.CompletedProcess(arguments, code, program.stdout, program.stderr)

    def run_in_terminal(self, *arguments: str, until: str = "", lines: int = 24) -> str:
        """All that `tfbus ARGUMENTS` writes to a terminal of 80 columns; Ctrl-C ends it once that
        has `until` in it.
        """
        program = self.start_python(
            "tfbus.__main__",
            *arguments,
            env={"LINES": str(lines), "TERM": "xterm-256color"},
            is_terminal=True,
        )
        if until:
            eventually(lambda: until in program.stdout or program.exit_code is not None)
            assert until in program.stdout, f"{until!r} is not in {program.stdout!r}"
            program.signal(SIGINT)
        program.wait(timeout_s=DEADLINE_S)
        return program.stdout

    def close(self) -> None:
        """Close its nodes; the network ends the processes."""
        for node in reversed(self._nodes):
            node.close()


@contextmanager
def bare_host() -> Iterator[None]:
    """Until the end of the `with` a doctor finds that all interfaces of its host are up, no ROS
    around it and no clone of tfbus: it would ask sockets, /proc and git.
    """

    def interface(index: int, name: str) -> Interface:
        return Interface(name, True, True, False, address=f"192.0.2.{index % 256}", number=index)

    def none_joined(*_: object) -> Never:
        raise OSError

    with (
        patch("tfbus.doctor.examine.is_taken", lambda port: False),
        patch("tfbus.doctor.examine.joined_socket", none_joined),
        patch("tfbus.doctor.examine.RosWatch.look_at_router", lambda watch: None),
        patch("tfbus.base.addresses.interface_of", interface),
        patch("tfbus.doctor.examine.local_scouts", dict),
        patch("tfbus.base.installation.commit_of_clone", lambda: ""),
    ):
        yield
