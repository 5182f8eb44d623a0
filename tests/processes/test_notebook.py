"""A node in a real notebook, where a cell can be interrupted."""

from collections.abc import Iterator
from typing import Any

import pytest

from tests import needs
from tests.buses import DEADLINE_S, eventually
from tests.live_bus import Bus

pytestmark = pytest.mark.real

TICKS = """
import tfbus
node = tfbus.Node("cells")
ticks = []
node.create_timer(0.01, lambda: ticks.append(1))
print("looping", flush=True)
while node.wait(0.01):
    pass
"""


class Notebook:
    """A kernel that runs cells."""

    def __init__(self, client: Any, manager: Any) -> None:
        self._client = client
        self._manager = manager

    def run(self, cell: str, *, interrupt_at: str = "") -> str:
        """What the cell prints, and the name of what it raises; interrupted once it prints that."""
        request = self._client.execute(cell)
        said = ""
        while True:
            message = self._client.get_iopub_msg(timeout=DEADLINE_S)
            if message["parent_header"].get("msg_id") != request:
                continue
            kind, content = message["msg_type"], message["content"]
            if kind == "stream":
                said += content["text"]
                if interrupt_at and interrupt_at in said:
                    interrupt_at = ""
                    self._manager.interrupt_kernel()
            elif kind == "error":
                said += content["ename"]
            elif kind == "status" and content["execution_state"] == "idle":
                return said.strip()


@pytest.fixture
def notebook(bus: Bus) -> Iterator[Notebook]:
    """A notebook with a kernel of its own on the bus of the test."""
    needs.module("ipykernel")
    manager = needs.module("jupyter_client.manager").KernelManager()
    manager.start_kernel(env=bus.env)
    client = manager.blocking_client()
    client.start_channels()
    try:
        client.wait_for_ready(timeout=DEADLINE_S)
        yield Notebook(client, manager)
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def test_an_interrupted_cell_leaves_its_node_alive(notebook: Notebook) -> None:
    """The cell raises KeyboardInterrupt; the next ones wait, spin and hear of timers as before."""
    assert notebook.run(TICKS, interrupt_at="looping").endswith("KeyboardInterrupt")
    assert notebook.run("print(node.ok, node.wait(0.01))") == "True True"
    assert notebook.run("n = len(ticks)") == ""
    eventually(lambda: notebook.run("node.wait(0.1); print(len(ticks) > n)") == "True")
    spun = notebook.run("print('spin', flush=True); node.spin()", interrupt_at="spin")
    assert spun.endswith("KeyboardInterrupt")
    assert notebook.run("node.wait(0.01), node.close(); print(node.ok)") == "False"
