"""Limits of this process: what it may lock, and those of processes for files of strangers, which
bear the cost of one in place of their parent.
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
    """Limit what this process may take, if the system has such limits: beyond the memory Python
    raises MemoryError, beyond the time the process is killed.
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
