"""Atomic writing of files: after an interruption, a file is either complete or absent."""

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

# Prefix of temporary files. The prefix is unique, so that no other file is deleted by mistake.
_PREFIX = ".pssf-"
_own_temporary_files = set[str]()  # paths of the temporary files that the current process is writing
# Error numbers of file systems that cannot flush a file or change a file mode. A full disk has other error numbers.
_UNSUPPORTED_ERRNOS = {errno.EPERM, errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, which replaces `path` when the ``with`` block ends without an error.

    If the block raises an exception, the temporary file is deleted and the content of `path` is unchanged. The mode of
    a new file is determined by the umask. The mode of a replaced file is unchanged.

    Parameters
    ----------
    path : Path
        File to write. Its folder is created if it does not exist.

    Yields
    ------
    Path
        Temporary path with the suffix of `path`, to which the ``with`` block must write.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written. The message contains the file path.
    """
    held: _TemporaryFile | None = None
    try:
        make_folder(path.parent)
        held = _create_temporary_file(path)
        _own_temporary_files.add(held.name)
        yield Path(held.name)
        _flush(held.name)
        if held.mode is not None:
            with suppress(OSError):  # The file systems CIFS and gvfs do not support file modes.
                os.chmod(held.name, held.mode)
        os.replace(held.name, path)
    except OSError as error:
        raise make_write_error(path, error) from None
    finally:
        if held is not None:
            with suppress(OSError):
                Path(held.name).unlink(missing_ok=True)
            _own_temporary_files.discard(held.name)
            held.close()


def _flush(name: str) -> None:
    """Flush a file to the disk, unless the file system does not support flushing, as on some network shares."""
    with open(name, "r+b") as handle:  # Windows can flush only a file that is open for writing.
        try:
            os.fsync(handle.fileno())
        except OSError as error:
            if error.errno not in _UNSUPPORTED_ERRNOS:
                raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically.

    Parameters
    ----------
    path : Path
        File to write. Its folder is created if it does not exist.
    content : bytes
        Complete content of the file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written. The message contains the file path.
    """
    with replace_file(path) as temporary:
        temporary.write_bytes(content)


def copy_file(source: Path, path: Path) -> None:
    """Copy a file.

    Parameters
    ----------
    source : Path
        File to copy.
    path : Path
        The copy.

    Raises
    ------
    InputError
        If `source` cannot be read or `path` cannot be written.
    """
    try:
        content = source.read_bytes()
    except OSError as error:
        raise InputError(f"file {source} cannot be read, got {error.strerror or error}") from None
    write_bytes(path, content)


def delete_own_temporary_files() -> None:
    """Delete all temporary files of the current process before the process is terminated."""
    for name in list(_own_temporary_files):
        with suppress(OSError):
            os.unlink(name)


def find_temporary_files(path: Path) -> list[Path]:
    """List the temporary files in a folder, including those of killed processes.

    Parameters
    ----------
    path : Path
        Folder to search. Subfolders are not searched.

    Returns
    -------
    list of Path
        Temporary files, sorted by name.
    """
    return sorted(path.glob(f"{_PREFIX}*"))


def delete_stale_temporary_files(path: Path) -> None:
    """Delete the temporary files of killed processes from a folder. Files of running processes are not deleted.

    On Windows, the function deletes no files.

    Parameters
    ----------
    path : Path
        Folder to clean. Subfolders are not searched.
    """
    if sys.platform == "win32":
        return
    for left in find_temporary_files(path):
        # A locked file belongs to a running process and is not deleted. No file is deleted on a file system without
        # locks.
        with suppress(OSError):
            handle = os.open(left, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                left.unlink()
            finally:
                os.close(handle)


def make_folder(path: Path) -> Path:
    """Create a folder and its parents if they do not exist.

    Parameters
    ----------
    path : Path
        Folder to create.

    Returns
    -------
    Path
        Path of the folder.

    Raises
    ------
    InputError
        The folder cannot be created. The message contains the folder path.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise make_write_error(path, error) from None
    return path


@contextmanager
def make_temporary_folder() -> Iterator[Path]:
    """Yield an empty folder, which is deleted with its content when the ``with`` block ends.

    Yields
    ------
    Path
        Path of the temporary folder.
    """
    with TemporaryDirectory() as name:
        yield Path(name)


def make_write_error(path: Path, error: OSError) -> InputError:
    """Create the InputError for a file or folder that cannot be written.

    Parameters
    ----------
    path : Path
        Path of the file or folder, shown in the error message.
    error : OSError
        Error that the operating system or a library raised.

    Returns
    -------
    InputError
        Error with a one-line message, to be raised by the caller.
    """
    # NumPy errors state the number of bytes written but no reason, so a full disk is assumed.
    # pydicom errors contain a traceback after the first line, so only the first line is used.
    reason = error.strerror or f"not enough free space ({(str(error).splitlines() or [''])[0]})"
    return InputError(f"file {path} must be writable, got {reason}: use a writable folder with free space")


@dataclass(frozen=True, kw_only=True)
class _TemporaryFile:
    """New temporary file, which is locked as long as its handle is open.

    `handle` is None on Windows, because Windows cannot write to a file with another open handle. `mode` is the mode of
    the file to be replaced, or None if no such file exists.
    """

    name: str
    handle: int | None
    mode: int | None

    def close(self) -> None:
        """Close the file handle and thereby release the lock."""
        if self.handle is not None:
            os.close(self.handle)


def _create_temporary_file(path: Path) -> _TemporaryFile:
    """Create a locked file in the folder of `path`.

    The lock indicates to other processes that the writing process is running. The lock is released when the handle is
    closed or the process ends.
    """
    mode = None
    with suppress(FileNotFoundError):
        mode = stat.S_IMODE(path.stat().st_mode)
    # The temporary file is private until it receives the mode of the file that it replaces.
    first_mode = 0o666 if mode is None else 0o600
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
    while True:
        # The stem is shortened, because a name with a random suffix may be too long for the file system.
        name = str(path.with_name(f"{_PREFIX}{path.stem[:40]}-{secrets.token_hex(4)}{path.suffix}"))
        try:
            handle = os.open(name, flags, first_mode)
        except FileExistsError:
            continue
        if sys.platform == "win32":  # Windows cannot write to a file with another open handle.
            os.close(handle)
            return _TemporaryFile(name=name, handle=None, mode=mode)
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(name):
            return _TemporaryFile(name=name, handle=handle, mode=mode)
        os.close(handle)  # Another process deleted the file before the file was locked.
