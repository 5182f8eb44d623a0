"""A few threads for jobs that may block, in the background."""

import threading
from collections import deque
from collections.abc import Callable

Job = Callable[[], None]


class Workers:
    """Runs jobs on at most `threads` threads; at most `waiting` further ones wait for a thread.

    Threads exist only while they have jobs, and do not hold up the end of the process. Jobs
    handle their exceptions themselves.
    """

    def __init__(self, name: str, *, threads: int, waiting: int) -> None:
        self._name = name
        self._most_threads = threads
        self._most_waiting = waiting
        self._lock = threading.Lock()
        self._running = 0
        self._waiting: deque[Job] = deque()

    def do(self, job: Job) -> bool:
        """Run the job soon; False where too many wait already: then it does not run."""
        with self._lock:
            if self._running < self._most_threads:
                threading.Thread(
                    target=self._run, args=(job,), name=self._name, daemon=True
                ).start()
                self._running += 1
            elif len(self._waiting) < self._most_waiting:
                self._waiting.append(job)
            else:
                return False
        return True

    def _run(self, job: Job | None) -> None:
        while job is not None:
            job()
            job = self._next()

    def _next(self) -> Job | None:
        with self._lock:
            if self._waiting:
                return self._waiting.popleft()
            self._running -= 1
            return None
