"""A file appears whole or not at all."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import IO

from ..core.checks import InputError

if sys.platform != "win32":
    import fcntl

# No file of anybody else's begins like this, so that `sweep` cannot take one.
_PREFIX = ".pssf-"
_at_work = set[str]()  # temporary files that this process writes to now


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder, which becomes `path` when the block ends well and vanishes when it does not.

    raises  InputError naming the file when the disk is full or cannot be written
    """
    held: IO[bytes] | None = None
    try:
        folder(path.parent)
        held = _temporary(path)
        _at_work.add(held.name)
        yield Path(held.name)
        with open(held.name, "rb") as handle:
            os.fsync(handle.fileno())
        os.chmod(held.name, 0o644)
        os.replace(held.name, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        if held is not None:
            with suppress(OSError):
                Path(held.name).unlink(missing_ok=True)
            _at_work.discard(held.name)
            held.close()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file.

    raises  InputError naming the file when the disk is full or cannot be written
    """
    with writing(path) as temporary:
        temporary.write_bytes(content)


def drop_unfinished() -> None:
    """Delete the temporary files of this process, which ends in the midst of them."""
    for name in list(_at_work):
        with suppress(OSError):
            os.unlink(name)


def unfinished(path: Path) -> list[Path]:
    """Temporary files in a folder: of writers at work, or of such as were killed."""
    return sorted(path.glob(f"{_PREFIX}*"))


def sweep(path: Path) -> None:
    """Delete the temporary files that writers left in a folder when they were killed; those being written stay."""
    if sys.platform == "win32":
        return
    for left in unfinished(path):
        # A lock that is held, or a file system without locks: whose file it is cannot be told, so it stays.
        with suppress(OSError):
            handle = os.open(left, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                left.unlink()
            finally:
                os.close(handle)


def folder(path: Path) -> Path:
    """The folder itself, made if need be.

    raises  InputError naming the folder when it cannot be made
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(path, error) from None
    return path


@contextmanager
def empty_folder() -> Iterator[Path]:
    """An empty folder that is gone, with all in it, when the block ends."""
    with TemporaryDirectory() as name:
        yield Path(name)


def unwritable(path: Path, error: OSError) -> InputError:
    """The refusal that names a file that cannot be written."""
    # numpy says how much of an array it could write, and not why.
    # pydicom hands on what the disk said with a traceback below it.
    reason = error.strerror or f"no room for all of it ({(str(error).splitlines() or [''])[0]})"
    return InputError(f"file {path}: {reason}; allowed: a folder that can be written, with room left")


def _temporary(path: Path) -> IO[bytes]:
    """A new file beside `path`, locked until its handle is closed or its process dies, so that `sweep` knows it."""
    while True:
        prefix = f"{_PREFIX}{path.stem[:40]}-"  # with what makes it one of its kind, it fits where the name does
        handle = NamedTemporaryFile(dir=path.parent, prefix=prefix, suffix=path.suffix, delete=False)  # noqa: SIM115
        if sys.platform == "win32":  # which writes to no file that is open elsewhere
            handle.close()
            return handle
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(handle.name):
            return handle
        handle.close()  # a sweep came between making and locking
