"""A few threads for jobs that may block, in the background."""

from collections import deque
from collections.abc import Callable

from tfbus.runtime import scheduler

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
        self._lock = scheduler.Lock()
        # In the order of their starts, in which `close` joins them.
        self._threads: dict[scheduler.Thread, None] = {}
        self._waiting: deque[Job] = deque()
        self._closed = False

    def do(self, job: Job) -> bool:
        """Run the job soon; False if too many wait already, or after `close`: then it does not
        run.
        """
        with self._lock:
            if self._closed:
                return False
            if len(self._threads) < self._most_threads:
                thread = scheduler.Thread(
                    target=self._run, args=(job,), name=self._name, daemon=True
                )
                thread.start()
                self._threads[thread] = None
            elif len(self._waiting) < self._most_waiting:
                self._waiting.append(job)
            else:
                return False
        return True

    def close(self, patience_s: float) -> None:
        """Drop the jobs that wait, and wait at most `patience_s` seconds for those that run."""
        with self._lock:
            self._closed = True
            self._waiting.clear()
            here = scheduler.current_thread()
            running = [thread for thread in self._threads if thread is not here]
        deadline = scheduler.monotonic() + patience_s
        for thread in running:
            thread.join(max(deadline - scheduler.monotonic(), 0.0))

    def _run(self, job: Job | None) -> None:
        while job is not None:
            job()
            job = self._next()

    def _next(self) -> Job | None:
        with self._lock:
            if self._waiting:
                return self._waiting.popleft()
            self._threads.pop(scheduler.current_thread(), None)
            return None
