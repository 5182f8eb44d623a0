"""How many files this process may still open: each link to another process is one."""

import logging
import os
import sys
from contextlib import suppress

# So few that the next processes may not find room.
_FEW = 8


class OpenFilesWatch:
    """Warns once if this process comes to its limit of open files.

    Zenoh says nothing if it cannot open another link: the processes beyond are never seen.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._has_warned = False

    def look(self) -> None:
        """Compare the open files with the limit, as after a link has opened."""
        if self._has_warned or sys.platform == "win32":
            return
        import resource

        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        used = limit  # where it is reached, they cannot be listed either
        with suppress(OSError):
            used = len(os.listdir("/dev/fd"))
        if limit - used < _FEW and limit != resource.RLIM_INFINITY:
            self._has_warned = True
            self._log.warning(
                "%d of %d open files are in use: further processes on the bus may stay unseen. "
                "Raise the limit (ulimit -n 4096), or use a router (--mode client)",
                used,
                limit,
            )
