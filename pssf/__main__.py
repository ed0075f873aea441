"""python -m pssf, and the command pssf: the command line, which an interrupt ends at once."""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path and sys.path[:1] == [os.getcwd()]:
    # `python -m` looks for modules in the working folder first: a file `signal.py` there would be run instead of
    # Python's own. Where this package is in that folder, the folder stays, after the standard library.
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
    # What Python tidies up after a pool that was stopped is no news for a user.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    from .cli import main as run

    run()


def _stop(number: int, frame: FrameType | None) -> None:
    """End in one line and exit code 130; an exception would wait for threads, and be lost in others' callbacks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        # A bar has hidden the cursor, and stands in the line.
        before = b"\r\x1b[2K\x1b[?25h" if os.isatty(2) else b""
        os.write(2, before + b"pssf: stopped; run the same command to go on\n")
    processes, files = (sys.modules.get(name) for name in ("multiprocessing.process", "pssf.io.atomic"))
    if processes is not None:
        for child in processes.active_children():
            child.terminate()
    if files is not None:
        files.drop_unfinished()
    os._exit(130)


if __name__ == "__main__":
    main()
