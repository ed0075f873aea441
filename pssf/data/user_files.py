"""Readers of files that a user names: regular files below a size limit, so that no pipe or device blocks a program."""

import json
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ..core.checks import InputError, format_one_line
from .table_records import MSGSPEC_LOCK

T = TypeVar("T")
# Largest text file that is read, in bytes.
MOST_TEXT = 2**28
# Largest file that is read, in bytes.
MOST_BYTES = 2**32
# Requirement on a file that the package wrote, and the remedy if it is not met.
_DELETE_HINT = "undamaged (delete it to have it made again)"


def read_bytes(path: Path, max_bytes: int = MOST_BYTES, allowed: str = "a readable file") -> bytes:
    """Read a regular file.

    Parameters
    ----------
    path : Path
        The file.
    max_bytes : int, default 2**32
        Size limit, in bytes.
    allowed : str, default "a readable file"
        What the file must be, in the error message.

    Returns
    -------
    bytes
        Content of the file.

    Raises
    ------
    InputError
        If the file is missing, unreadable, too large or not a regular file. The message names it.
    """
    with convert_os_errors(path, allowed):
        # Non-blocking, since opening a pipe that has no writer would otherwise wait.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb") as file:
            _require_regular(path, os.fstat(handle), max_bytes, allowed)
            return file.read()


def require_regular_file(path: Path, max_bytes: int = MOST_BYTES, allowed: str = "a readable file") -> Path:
    """Require a regular file below a size limit, for a reader that opens the file itself.

    Parameters
    ----------
    path : Path
        The file.
    max_bytes : int, default 2**32
        Size limit, in bytes.
    allowed : str, default "a readable file"
        What the file must be, in the error message.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    InputError
        As `read_bytes`.
    """
    with convert_os_errors(path, allowed):
        _require_regular(path, os.stat(path), max_bytes, allowed)
    return path


def read_text(path: Path, max_bytes: int = MOST_TEXT, allowed: str = "a readable file") -> str:
    """Read a UTF-8 text file; a leading byte-order mark is removed.

    Parameters
    ----------
    path : Path
        The file.
    max_bytes : int, default 2**28
        Size limit, in bytes.
    allowed : str, default "a readable file"
        What the file must be, in the error message.

    Returns
    -------
    str
        Text of the file.

    Raises
    ------
    InputError
        As `read_bytes`, and if the content is not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes, allowed).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"file {path} must be {allowed}, got: not UTF-8 ({error})") from None


def parse_text(path: Path, text: T, parse: Callable[[T], Any], *, fault: str, allowed: str) -> Any:
    """Parse the text of a file; any failure of the parser raises InputError.

    Parameters
    ----------
    path : Path
        The file, for the error message.
    text : str or file object
        Input of the parser.
    parse : callable
        Parser.
    fault : str
        What is wrong with a file that cannot be parsed, such as "not TOML".
    allowed : str
        What the file must be, in the error message.

    Returns
    -------
    Any
        Result of the parser.

    Raises
    ------
    InputError
        If the parser fails.
    """
    try:
        return parse(text)
    except (ValueError, RecursionError) as error:  # Errors of all parsers are subclasses of these.
        raise InputError(f"file {path} must be {allowed}, got: {fault} ({format_one_line(str(error))})") from None


def read_json(path: Path, record_type: type[T] | Any, *, allowed: str = _DELETE_HINT) -> T:
    """Read a JSON file as a record or another type that msgspec knows; every name and type is checked.

    Parameters
    ----------
    path : Path
        The file.
    record_type : type
        Type to convert to.
    allowed : str
        What the file must be, in the error message. By default a file that pssf wrote.

    Returns
    -------
    record_type
        The typed content.

    Raises
    ------
    InputError
        As `read_text`, and if the content is not JSON or not of this type.
    """
    # Python's JSON reader is used, since it accepts NaN, which stands for the position of a hidden landmark.
    held = parse_text(path, read_text(path), json.loads, fault="damaged", allowed=allowed)
    try:
        with MSGSPEC_LOCK:
            return msgspec.convert(held, record_type)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path} must be {allowed}, got: damaged ({error})") from None


@contextmanager
def convert_os_errors(path: Path, allowed: str) -> Iterator[None]:
    """Convert errors of the operating system in this context to an InputError of one line that names the file.

    Parameters
    ----------
    path : Path
        The file, for the error message.
    allowed : str
        What the file must be, in the error message.

    Yields
    ------
    None
        The block accesses the file.

    Raises
    ------
    InputError
        If the system reports an error, or the path contains a null byte.
    """
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"file {path} must be {allowed}, got: {error.strerror or error}") from None
    except ValueError as error:  # The path contains a null byte.
        raise InputError(f"file {path} must be {allowed}, got: {error}") from None


def _require_regular(path: Path, status: os.stat_result, max_bytes: int, allowed: str) -> None:
    """Raise InputError for a folder, a pipe, socket or device, or a file that is too large."""
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"file {path} must be {allowed}, got: Is a directory")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"file {path} must be {allowed}, got: no regular file (a pipe, socket or device)")
    if status.st_size > max_bytes:
        raise InputError(f"file {path} must have at most {max_bytes} bytes, got {status.st_size} bytes")
