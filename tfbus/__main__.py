"""The command `tfbus`, and `python -m tfbus`."""

import signal
import sys


def main() -> None:
    """Run the command line.

    SIGINT ends the process at once and without a word, as by the system's default, until a tool
    or node takes the signal for itself. Python's own handler would print where in which import
    Ctrl-C struck.
    """
    # Where a shell started it in the background, SIGINT is ignored and stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # `tfbus launch` holds back from its nodes what comes before this line.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    from tfbus.runtime.sources import why_not_installed

    if mistake := why_not_installed():
        sys.exit(f"Error: {mistake}")
    from tfbus.cli import main as command_line  # click and more: 60 ms

    command_line()


if __name__ == "__main__":
    main()
