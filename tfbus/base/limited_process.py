"""The memory and time of this process: their limits, and the memory that it keeps; and processes
for files of strangers, which bear the cost of a file in place of their parent.
"""

import sys
from contextlib import suppress
from pathlib import Path


def command_of(module: str) -> list[str]:
    """The command line that calls `main` of a module, as this process would import it: with
    its paths, and not with the working directory, where anything may lie.
    """
    program = f"import sys; sys.path[:] = sys.argv[1:]; from {module} import main; main()"
    return [sys.executable, "-c", program, *filter(None, sys.path)]


def limit_this_process(*, memory_bytes: int, cpu_s: float | None = None) -> None:
    """Limit the memory and time of this process, if the system has such limits: beyond the memory
    Python raises MemoryError, beyond the time the process is killed.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    limits = {resource.RLIMIT_AS: memory_bytes}
    if cpu_s is not None:
        limits[resource.RLIMIT_CPU] = round(cpu_s)
    for limit, most in limits.items():
        hard = resource.getrlimit(limit)[1]
        resource.setrlimit(
            limit, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard)
        )


# From Linux's <linux/capability.h>.
_MAY_LOCK_ALL = 1 << 14


def lockable_bytes() -> int:
    """How much memory this process may lock, 2^63 without a limit."""
    unlimited: int = 2**63
    try:
        import resource
    except ImportError:  # Windows
        return unlimited
    with suppress(OSError, StopIteration, ValueError):  # not Linux
        lines = Path("/proc/self/status").read_text().splitlines()
        capabilities = next(line for line in lines if line.startswith("CapEff:"))
        if int(capabilities.split()[1], 16) & _MAY_LOCK_ALL:
            return unlimited
    soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    return unlimited if soft == resource.RLIM_INFINITY else soft


# From glibc's <malloc.h>.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT, _LARGEST_KEPT = 64 * 1024 * 1024, 32 * 1024 * 1024


def keep_freed_memory() -> None:
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
