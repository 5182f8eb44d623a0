"""The command `tfbus`, and `python -m tfbus`."""

import io
import signal
import sys
import warnings


def main() -> None:
    """Run the command line.

    SIGINT ends the process at once and without a word, as by the system's default, until a tool
    or node takes the signal for itself. Python's own handler would print where in which import
    Ctrl-C struck.
    """
    # Python drops a signal that comes in the instant in which its handler is replaced by the
    # system's: it waits until that is done.
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # If a shell started it in the background, SIGINT is ignored and stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # `tfbus launch` holds back signals from its nodes up to this line.
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    # A letter that the terminal's encoding lacks, or half of one on the command line, is printed as
    # an escape instead of a traceback.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    from tfbus.base.installation import InterpretedWarning, why_not_installed

    if mistake := why_not_installed():
        sys.exit(f"Error: {mistake}")
    # `tfbus --version` and `tfbus doctor` say it, in place of every process.
    warnings.simplefilter("ignore", InterpretedWarning)
    from tfbus.cli import main as command_line  # click and more: 60 ms

    command_line()


if __name__ == "__main__":
    main()
