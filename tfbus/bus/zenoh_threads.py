"""How many threads Zenoh receives with.

Zenoh's default is two for all links. Closing the link to a host that no longer answers blocks a
thread for 10 s (eclipse-zenoh/zenoh#1101, #2718): if two links of such a host end, nothing is
received from any other. A thread that waits takes 20 kB and no CPU.
"""

import os

# One more than the processes of an unplugged host that may be linked to this one: from some thirty
# on a host needs a router, which is one link.
_RECEIVING = 32


def configure_zenoh_threads() -> None:
    """Let Zenoh receive with 32 threads, unless ZENOH_RUNTIME is set.

    Zenoh reads it once, when its first session opens in this process.
    """
    os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {_RECEIVING}))")
