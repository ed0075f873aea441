"""Start Python processes that ignore the files of the working folder.

A new Python process searches for modules in the working folder first. A file ``signal.py`` in this folder would
therefore replace the standard module ``signal`` in every worker.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Code of a child process, which copies the import path of the parent process before any other import.
_CODE = "import sys; sys.path[:] = sys.argv.pop(1).splitlines(); {code}"
_SAFE_PATH_VARIABLE = "PYTHONSAFEPATH"


@contextmanager
def start_without_working_folder() -> Iterator[None]:
    """Start multiprocessing workers in this context without the working folder in their initial import path.

    The workers run the main script of the parent process only if the script is a file, not if it is standard input.

    Yields
    ------
    None
        The previous environment is restored at the end of the block.
    """
    main, before = sys.modules["__main__"], os.environ.get(_SAFE_PATH_VARIABLE)
    file = getattr(main, "__file__", None)
    missing = file is not None and not os.path.exists(file)
    if missing:
        main.__file__ = None
    os.environ[_SAFE_PATH_VARIABLE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH_VARIABLE, None)
        else:
            os.environ[_SAFE_PATH_VARIABLE] = before
        if missing:
            main.__file__ = file


def build_python_command(code: str, *arguments: str) -> list[str]:
    """Build the command that runs code in a new Python process with the import path of this process.

    Parameters
    ----------
    code : str
        Python statements; ``sys`` is already imported.
    *arguments : str
        Values of ``sys.argv[1:]``.

    Returns
    -------
    list of str
        Command as a list of program and arguments.
    """
    path = "\n".join(str(Path(entry or ".").absolute()) for entry in sys.path)
    return [sys.executable, "-P", "-c", _CODE.format(code=code), path, *arguments]
