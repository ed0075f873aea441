"""A file appears whole or not at all."""

import errno
import os
import secrets
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ..core.checks import InputError

if sys.platform != "win32":
    import fcntl

# No file of anybody else's begins like this, so that `sweep` cannot take one.
_PREFIX = ".pssf-"
_at_work = set[str]()  # temporary files that this process writes to now
# What a file system answers that cannot flush, or cannot change a mode; a full disk answers otherwise.
_REFUSED = {errno.EPERM, errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder, which becomes `path` when the block ends well, and vanishes otherwise.

    A new file has the mode that the umask leaves, as of any program; one that is replaced keeps its own.

    Raises
    ------
    InputError
        The disk is full or cannot be written; the message names the file.
    """
    held: _Temporary | None = None
    try:
        folder(path.parent)
        held = _temporary(path)
        _at_work.add(held.name)
        yield Path(held.name)
        _flush(held.name)
        if held.mode is not None:
            with suppress(OSError):  # CIFS and gvfs know no modes
                os.chmod(held.name, held.mode)
        os.replace(held.name, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        if held is not None:
            with suppress(OSError):
                Path(held.name).unlink(missing_ok=True)
            _at_work.discard(held.name)
            held.close()


def _flush(name: str) -> None:
    """Have the system write a file to the disk, where it can: some remote and user file systems refuse."""
    with open(name, "r+b") as handle:  # Windows flushes only what can be written
        try:
            os.fsync(handle.fileno())
        except OSError as error:
            if error.errno not in _REFUSED:
                raise


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


@dataclass(frozen=True, kw_only=True)
class _Temporary:
    """A new file, locked as long as its handle is open.

    handle  None where it cannot be open while others write to it
    mode    of the file that it will replace; None where there is none
    """

    name: str
    handle: int | None
    mode: int | None

    def close(self) -> None:
        if self.handle is not None:
            os.close(self.handle)


def _temporary(path: Path) -> _Temporary:
    """Make a file beside `path`, locked until its handle is closed or its process dies, so that `sweep` knows it."""
    mode = None
    with suppress(FileNotFoundError):
        mode = stat.S_IMODE(path.stat().st_mode)
    # Nobody else reads it before it has the mode of the file that it replaces.
    first_mode = 0o666 if mode is None else 0o600
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
    while True:
        # With what makes it one of its kind, it fits where the name does.
        name = str(path.with_name(f"{_PREFIX}{path.stem[:40]}-{secrets.token_hex(4)}{path.suffix}"))
        try:
            handle = os.open(name, flags, first_mode)
        except FileExistsError:
            continue
        if sys.platform == "win32":  # which writes to no file that is open elsewhere
            os.close(handle)
            return _Temporary(name=name, handle=None, mode=mode)
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(name):
            return _Temporary(name=name, handle=handle, mode=mode)
        os.close(handle)  # a sweep came between making and locking
