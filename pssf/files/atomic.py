"""A file appears whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory

from ..checks import InputError


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder, which becomes `path` when the block ends well and vanishes when it does not.

    raises  InputError naming the file when the disk is full or cannot be written
    """
    temporary: Path | None = None
    try:
        folder(path.parent)
        with NamedTemporaryFile(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix, delete=False) as handle:
            temporary = Path(handle.name)
        yield temporary
        with open(temporary, "rb") as handle:
            os.fsync(handle.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file.

    raises  InputError naming the file when the disk is full or cannot be written
    """
    with writing(path) as temporary:
        temporary.write_bytes(content)


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
    reason = error.strerror or f"no room for all of it ({error})"
    return InputError(f"file {path}: {reason}; allowed: a folder that can be written, with room left")
