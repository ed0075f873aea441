"""Run a function in a background process while this process works on; a failure there has no effect here."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path

from .child_processes import build_python_command
from .parallel_map import count_cores

# The process runs this text alone. A process of multiprocessing would run the user's main script again.
_CODE = "from pssf.core.processes.background_process import run_function; run_function(*sys.argv[1:])"


def can_run_in_background() -> bool:
    """Check whether a background process is possible and useful.

    Returns
    -------
    bool
        True if there is a spare core, a Python interpreter to start, and this process is no worker itself.
    """
    name = Path(sys.executable or "").name.lower()
    # If Python is built into another program, that program would start once more.
    return (
        name.startswith("python")
        and not getattr(sys, "frozen", False)
        and parent_process() is None
        and count_cores() > 1
    )


@contextmanager
def run_in_background(
    module: str, function: str, *arguments: str, environment: Mapping[str, str], timeout_s: float
) -> Iterator[None]:
    """Run a function in a background process while the context is open, and wait for it at the end of the block.

    If the block fails, the process is killed at once.

    Parameters
    ----------
    module : str
        Full name of the module that holds the function.
    function : str
        Name of the function.
    *arguments : str
        Arguments of the function; text only.
    environment : mapping of str to str
        Environment variables of the process.
    timeout_s : float
        Time to wait from the end of the block, in s. Then the process is killed.

    Yields
    ------
    None
        The block runs even if the process cannot be started.
    """
    process = _start_process(module, function, *arguments, environment=environment)
    if process is None:
        yield
        return
    with process:
        try:
            yield
            with suppress(subprocess.TimeoutExpired):
                process.wait(timeout_s)
        finally:
            process.kill()


def _start_process(*command: str, environment: Mapping[str, str]) -> "subprocess.Popen[bytes] | None":
    """Start the background process; return None if the system refuses."""
    with suppress(OSError):
        return subprocess.Popen(
            build_python_command(_CODE, *command),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=dict(environment),
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    return None


def run_function(module: str, function: str, *arguments: str) -> None:
    """Run the function in the background process; end the process if its parent ends.

    Parameters
    ----------
    module : str
        Full name of the module that holds the function.
    function : str
        Name of the function.
    *arguments : str
        Arguments of the function.
    """
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    from importlib import import_module

    getattr(import_module(module), function)(*arguments)
    os._exit(0)


def _exit_with_parent() -> None:
    """End this process when its parent ends: nobody writes to standard input, so that a read returns only then."""
    os.read(0, 1)
    os._exit(1)
