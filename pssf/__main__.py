"""Run the command line, as ``pssf`` or ``python -m pssf``; an interrupt stops the process immediately."""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path and sys.path[:1] == [os.getcwd()]:
    # With `python -m`, Python searches the working folder first, so a file `signal.py` in it would replace the module
    # of the standard library. The working folder is removed from the search path. If the working folder contains pssf,
    # the folder is moved behind the standard library instead.
    _folder, _library = sys.path.pop(0), os.path.dirname(os.__file__)
    if os.path.dirname(os.path.dirname(os.path.abspath(__file__))) == _folder:
        _places = [sys.path.index(one) for one in (_library, os.path.join(_library, "lib-dynload")) if one in sys.path]
        sys.path.insert(max(_places, default=-1) + 1, _folder)

import signal
from contextlib import suppress
from types import FrameType


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, _stop)
    # After an interrupt, Python warns that it releases resources of stopped workers. Users do not need the warning.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    from .cli import main as run

    run()


def _stop(number: int, frame: FrameType | None) -> None:
    """Stop the process with one line of text and exit code 130.

    No exception is raised, because the process would wait for threads, and a callback could suppress the exception.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        # A progress bar may be on the current line and hide the cursor, so the line is cleared and the cursor is shown.
        before = b"\r\x1b[2K\x1b[?25h" if os.isatty(2) else b""
        os.write(2, before + b"pssf: stopped; run the same command again to continue\n")
    processes, files = (sys.modules.get(name) for name in ("multiprocessing.process", "pssf.io.atomic_write"))
    if processes is not None:
        for child in processes.active_children():
            child.terminate()
    if files is not None:
        files.delete_own_temporary_files()
    os._exit(130)


if __name__ == "__main__":
    main()
