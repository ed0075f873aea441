"""safe_start, python_command: processes of Python that no file of the working folder can disturb.

A new Python looks for modules in the working folder first: a file `signal.py` there would be run by every worker.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Any import of the code comes after the path, which is that of this process.
_CODE = "import sys; sys.path[:] = sys.argv.pop(1).splitlines(); {code}"
_SAFE = "PYTHONSAFEPATH"


@contextmanager
def safe_start() -> Iterator[None]:
    """Start processes of multiprocessing inside this block, without the working folder in their first path.

    They run the main script of this process only where it is a file: a script from standard input is none.
    """
    main, before = sys.modules["__main__"], os.environ.get(_SAFE)
    file = getattr(main, "__file__", None)
    missing = file is not None and not os.path.exists(file)
    if missing:
        main.__file__ = None
    os.environ[_SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE, None)
        else:
            os.environ[_SAFE] = before
        if missing:
            main.__file__ = file


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs code in a new Python, with the path of this one, and nothing before it.

    Parameters
    ----------
    code
        Statements; `sys` is imported.
    *arguments
        What `sys.argv` holds from 1 on.
    """
    path = "\n".join(str(Path(entry or ".").absolute()) for entry in sys.path)
    return [sys.executable, "-P", "-c", _CODE.format(code=code), path, *arguments]
