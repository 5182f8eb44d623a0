"""How the processes of one machine find each other where the machine has no network."""

from pathlib import Path

_INTERFACES = Path("/sys/class/net")

# Of Linux's <net/if.h>.
_UP = 0x1
_LOOPBACK = 0x8
_MULTICAST = 0x1000


def loopback_where_alone() -> str:
    """The loopback interface where no other can carry multicast, "" otherwise.

    Zenoh scouts on every interface but loopback, so that without a network it finds nobody, not
    even on the same machine. Known on Linux only; "" elsewhere.
    """
    loopback = ""
    for interface in sorted(_INTERFACES.iterdir()) if _INTERFACES.is_dir() else ():
        flags = int((interface / "flags").read_text(), 16)
        if flags & _LOOPBACK:
            loopback = interface.name
        elif flags & _UP and flags & _MULTICAST:
            return ""
    return loopback
