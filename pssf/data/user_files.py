"""Read files that the user specifies; only regular files below a size limit are accepted, since a pipe may block."""

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
# Size limit of text files, in bytes (assumed).
MOST_TEXT = 2**28
# Size limit of all other files, in bytes (assumed).
MOST_BYTES = 2**32


def read_bytes(path: Path, max_bytes: int = MOST_BYTES, allowed: str = "a readable file") -> bytes:
    """Read a regular file as bytes.

    Parameters
    ----------
    path : Path
        Path of the file.
    max_bytes : int, default 2**32
        Size limit, in bytes.
    allowed : str, default "a readable file"
        Description of a valid file, shown in error messages.

    Returns
    -------
    bytes
        Content of the file.

    Raises
    ------
    InputError
        If the file is missing, unreadable, too large or not a regular file. The message names the file.
    """
    with convert_os_errors(path, allowed):
        # The file is opened in non-blocking mode, because opening a pipe without a writer would otherwise wait.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb") as file:
            _require_regular(path, os.fstat(handle), max_bytes, allowed)
            return file.read()


def require_regular_file(path: Path, max_bytes: int = MOST_BYTES, allowed: str = "a readable file") -> Path:
    """Check that a path is a regular file below a size limit, before another library opens it.

    Parameters
    ----------
    path : Path
        Path of the file.
    max_bytes : int, default 2**32
        Size limit, in bytes.
    allowed : str, default "a readable file"
        Description of a valid file, shown in error messages.

    Returns
    -------
    Path
        Path of the file, unchanged.

    Raises
    ------
    InputError
        Under the same conditions as `read_bytes`.
    """
    with convert_os_errors(path, allowed):
        _require_regular(path, os.stat(path), max_bytes, allowed)
    return path


def read_text(path: Path, max_bytes: int = MOST_TEXT, allowed: str = "a readable file") -> str:
    """Read a UTF-8 text file; a leading byte-order mark is removed.

    Parameters
    ----------
    path : Path
        Path of the file.
    max_bytes : int, default 2**28
        Size limit, in bytes.
    allowed : str, default "a readable file"
        Description of a valid file, shown in error messages.

    Returns
    -------
    str
        Text of the file.

    Raises
    ------
    InputError
        Under the same conditions as `read_bytes`, or if the content is not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes, allowed).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"file {path} must be {allowed}, got: not UTF-8 ({error})") from None


def parse_text(
    path: Path, text: T, parse: Callable[[T], Any], *, fault: str = "damaged", allowed: str | None = None
) -> Any:
    """Parse the text of a file and convert errors of the parser to InputError.

    Parameters
    ----------
    path : Path
        Path of the file, shown in error messages.
    text : str or file object
        Input of the parser function.
    parse : callable
        Function that parses `text`.
    fault : str, default "damaged"
        Description of a file that cannot be parsed, such as "not TOML", shown in error messages.
    allowed : str, optional
        Description of a valid file, shown in error messages. None means that the package wrote the file; the message
        then advises the user to delete the file.

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
    except (ValueError, RecursionError) as error:  # All parsers raise subclasses of these errors.
        raise _make_content_error(path, f"{fault} ({format_one_line(str(error))})", allowed) from None


def read_json(path: Path, record_type: type[T] | Any, *, allowed: str | None = None) -> T:
    """Read a JSON file as a record or another msgspec type, and check all names and types.

    Parameters
    ----------
    path : Path
        Path of the file.
    record_type : type
        Target type of the conversion.
    allowed : str, optional
        Description of a valid file, shown in error messages. None means that the package wrote the file; the message
        then advises the user to delete the file.

    Returns
    -------
    record_type
        Content of the file, converted to `record_type`.

    Raises
    ------
    InputError
        Under the same conditions as `read_text`, or if the content is not JSON or does not match the type.
    """
    # Python's JSON reader is used because it accepts NaN, which represents the position of a hidden landmark.
    held = parse_text(path, read_text(path), json.loads, allowed=allowed)
    try:
        with MSGSPEC_LOCK:
            return msgspec.convert(held, record_type)
    except msgspec.ValidationError as error:
        raise _make_content_error(path, f"damaged ({error})", allowed) from None


def _make_content_error(path: Path, fault: str, allowed: str | None) -> InputError:
    """Make the error for a file with invalid content; `allowed` is None for a file that the package wrote."""
    if allowed is None:
        return InputError(f"file {path} is {fault}; delete the file, and pssf makes it again")
    return InputError(f"file {path} must be {allowed}, got: {fault}")


@contextmanager
def convert_os_errors(path: Path, allowed: str) -> Iterator[None]:
    """Convert operating system errors in a ``with`` block to an InputError that names the file.

    Parameters
    ----------
    path : Path
        Path of the file, shown in error messages.
    allowed : str
        Description of a valid file, shown in error messages.

    Yields
    ------
    None
        The ``with`` block accesses the file.

    Raises
    ------
    InputError
        If the operating system reports an error, or the path contains a null byte.
    """
    try:
        yield
    except InputError:
        raise
    except IsADirectoryError:
        raise InputError(f"file {path} must be {allowed}, got a directory") from None
    except OSError as error:
        raise InputError(f"file {path} must be {allowed}, got: {error.strerror or error}") from None
    except ValueError as error:  # Python raises ValueError if the path contains a null byte.
        raise InputError(f"file {path} must be {allowed}, got: {error}") from None


def _require_regular(path: Path, status: os.stat_result, max_bytes: int, allowed: str) -> None:
    """Raise InputError if the path is a folder, pipe, socket or device, or if the file is too large."""
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"file {path} must be {allowed}, got a directory")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"file {path} must be {allowed}, got a pipe, socket or device")
    if status.st_size > max_bytes:
        raise InputError(f"file {path} must have at most {max_bytes} bytes, got {status.st_size} bytes")
