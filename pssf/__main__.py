"""Command line of the package, run as ``pssf`` or ``python -m pssf``; an interrupt stops it at once."""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path and sys.path[:1] == [os.getcwd()]:
    # With `python -m`, Python searches the working folder first, so that a file `signal.py` there would replace the
    # module of the standard library. The folder is removed from the search path. If it contains this package, it is
    # moved behind the standard library instead.
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
    # After a pool was stopped, Python warns about resources that it releases; users need not see that.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    from .cli import main as run

    run()


def _stop(number: int, frame: FrameType | None) -> None:
    """Stop with one line of text and exit code 130.

    An exception would wait for threads, and callbacks could swallow it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        # A progress bar may be on the line and has hidden the cursor; both are reset.
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
