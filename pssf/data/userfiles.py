"""Files that a user names, read: regular ones below a size, so that no pipe and no device is waited for."""

import json
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ..core.checks import InputError, one_line
from .records import TYPES_LOCK

T = TypeVar("T")
# No parameters, tables or films of anybody's are larger.
MOST_TEXT, MOST_BYTES = 2**28, 2**32
_AGAIN = "delete it to have it made again"


def read_bytes(path: Path, most: int = MOST_BYTES, allowed: str = "a readable file") -> bytes:
    """The content of a regular file of at most so many bytes.

    raises  InputError naming a file that is missing, unreadable, too large or no regular one
    """
    with refusing(path, allowed):
        # A pipe without a writer would be waited for.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb") as file:
            _require_regular(path, os.fstat(handle), most, allowed)
            return file.read()


def require_file(path: Path, most: int = MOST_BYTES, allowed: str = "a readable file") -> Path:
    """The path itself, if it is of a regular file of at most so many bytes, for a reader that opens it by name.

    raises  InputError as `read_bytes` does
    """
    with refusing(path, allowed):
        _require_regular(path, os.stat(path), most, allowed)
    return path


def read_text(path: Path, most: int = MOST_TEXT, allowed: str = "a readable file") -> str:
    """UTF-8 text of a file, without the byte-order mark that some editors put before it.

    raises  InputError as `read_bytes` does, and for what is no UTF-8
    """
    try:
        return read_bytes(path, most, allowed).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"file {path}: not UTF-8 ({error}); allowed: {allowed}") from None


def parsed(path: Path, text: T, parse: Callable[[T], Any], *, fault: str, allowed: str) -> Any:
    """What a parser makes of the text of a file, however it fails.

    fault   what a file is called that it fails for
    raises  InputError
    """
    try:
        return parse(text)
    except (ValueError, RecursionError) as error:  # of which every parser's own are kinds
        raise InputError(f"file {path}: {fault} ({one_line(str(error))}); allowed: {allowed}") from None


def read_json(path: Path, kind: type[T] | Any, *, allowed: str = _AGAIN) -> T:
    """A JSON file as a record, or another type that msgspec knows: every name and type is checked here.

    raises  InputError as `read_text` does, and for what is not JSON or of another form
    """
    # Python's reader, for the NaN that a place has which is not seen.
    held = parsed(path, read_text(path), json.loads, fault="damaged", allowed=allowed)
    try:
        with TYPES_LOCK:
            return msgspec.convert(held, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path}: damaged ({error}); allowed: {allowed}") from None


@contextmanager
def refusing(path: Path, allowed: str) -> Iterator[None]:
    """What the system says against a path becomes a refusal of one line that names the file.

    raises  InputError
    """
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: {allowed}") from None
    except ValueError as error:  # a null byte
        raise InputError(f"file {path}: {error}; allowed: {allowed}") from None


def _require_regular(path: Path, status: os.stat_result, most: int, allowed: str) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"file {path}: Is a directory; allowed: {allowed}")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"file {path}: no regular file (a pipe, socket or device); allowed: {allowed}")
    if status.st_size > most:
        raise InputError(f"file {path}: size = {status.st_size} bytes; allowed: up to {most} bytes")
