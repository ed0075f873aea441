"""KernelCache: numba's cache on disk, where a damaged file or a folder that cannot be written is a cache miss.

numba raises whatever a damaged cache file makes pickle raise, and refuses to define a function where neither the
folder of the source nor the user's cache folder can be written. Here every fault of the cache costs one compilation.
"""

import hashlib
import os
import pickle
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    NullCache,
    _CacheLocator,
    _SourceFileBackedLocatorMixin,
)


def cache_of(function: Any) -> FunctionCache | NullCache:
    """Return the cache of a function to compile; one that holds nothing where no folder can be written."""
    # Whatever numba cannot do for want of a cache, it can do without one.
    with suppress(Exception):
        return KernelCache(function)
    return NullCache()


class _TemporaryLocator(_SourceFileBackedLocatorMixin, _CacheLocator):
    """Locate the cache in the folder for temporary files, in a folder that nobody else can write to."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file = file
        self._lineno = function.__code__.co_firstlineno
        self._folder = Path(tempfile.gettempdir()) / f"pssf-numba-{_user()}"

    def ensure_cache_path(self) -> None:
        """Make the folders; raises OSError where that fails, or where the upper one is not this user's alone."""
        with suppress(FileExistsError):
            self._folder.mkdir(mode=0o700)
        _require_own(self._folder)
        super().ensure_cache_path()

    def get_cache_path(self) -> str:
        return str(self._folder / self.get_suitable_cache_subpath(self._py_file))


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def _require_own(folder: Path) -> None:
    """Refuse a folder that another user made or can write to: code from a cache file is run.

    Raises
    ------
    PermissionError
    """
    state = folder.lstat()
    own = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    if not (stat.S_ISDIR(state.st_mode) and own):
        raise PermissionError(f"{folder} is not this user's alone")


class _Files(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _TemporaryLocator]  # noqa: RUF012  as numba has it


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Write the key and a hash with the code, so that altered code and code of other types are not run.

    Two processes that compile one function for different types at once give both results the same file name.
    """

    def _load_index(self) -> Any:
        # A damaged index can fail anywhere in pickle; the next function that is saved writes it anew.
        with suppress(Exception):
            return super()._load_index()
        return {}

    def save(self, key: Any, data: Any) -> None:
        content = self._dump((key, data))
        super().save(key, (hashlib.sha256(content).digest(), content))

    def load(self, key: Any) -> Any:
        held = super().load(key)
        if held is None:
            return None
        digest, content = held
        if digest != hashlib.sha256(content).digest():
            return None
        written_for, data = pickle.loads(content)
        return data if written_for == key else None


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Keep compiled code of one function on disk; whatever fails in that is a cache miss.

    Raises
    ------
    RuntimeError
        No folder can be written (from numba, when constructed).
    """

    _impl_class = _Files

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load compiled code; None where there is none, or none that is whole."""
        with suppress(Exception):  # a damaged file can fail anywhere in pickle
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save compiled code, where the disk takes it."""
        with suppress(Exception):
            super().save_overload(sig, data)
