"""Processes for files of strangers: with limits of memory and time, they bear the cost of a file in
place of their parent.
"""

import sys


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
