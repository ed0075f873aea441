"""beside: a function in a process of its own, while this one does something else; whatever becomes of it."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path

from .child_processes import python_command
from .parallel import cores

# Text alone, so that the user's program is not run again, as a process of multiprocessing would.
_CODE = "from pssf.core.aside import run; run(*sys.argv[1:])"


def can_run_beside() -> bool:
    """Whether there is a core for another process, a Python to run in it, and this is no worker of a pool."""
    name = Path(sys.executable or "").name.lower()
    # A program that Python is built into would start once more.
    return name.startswith("python") and not getattr(sys, "frozen", False) and parent_process() is None and cores() > 1


@contextmanager
def beside(
    module: str, function: str, *arguments: str, environment: Mapping[str, str], patience_s: float
) -> Iterator[None]:
    """Run a function meanwhile, and wait for it at the end of the block; not if the block fails.

    arguments    of the function, text
    environment  variables of the process
    patience_s   after which it is killed; from the end of the block on
    """
    process = _started(module, function, *arguments, environment=environment)
    if process is None:
        yield
        return
    with process:
        try:
            yield
            with suppress(subprocess.TimeoutExpired):
                process.wait(patience_s)
        finally:
            process.kill()


def _started(*command: str, environment: Mapping[str, str]) -> "subprocess.Popen[bytes] | None":
    with suppress(OSError):
        return subprocess.Popen(
            python_command(_CODE, *command),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=dict(environment),
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    return None


def run(module: str, function: str, *arguments: str) -> None:
    """What runs in the process: the function, and no longer than its parent."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from importlib import import_module

    getattr(import_module(module), function)(*arguments)
    os._exit(0)


def _end_with_parent() -> None:
    """Nothing is ever written to this process: what it reads is the end of its parent."""
    os.read(0, 1)
    os._exit(1)
