"""Cache compiled kernels on disk, and treat every file or folder error as a cache miss.

The cache class of numba raises an error if a file is damaged, or if neither the source folder nor the user's cache
folder is writable. `KernelCache` compiles the function again instead.
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


def make_kernel_cache(function: Any) -> FunctionCache | NullCache:
    """Create the cache of a function that numba compiles.

    Parameters
    ----------
    function : callable
        Python function to be compiled.

    Returns
    -------
    FunctionCache or NullCache
        The cache, or a cache that stores nothing if no folder is writable.
    """
    # Any failure to create the cache is harmless, because numba can compile without a cache.
    with suppress(Exception):
        return KernelCache(function)
    return NullCache()


class _TemporaryLocator(_SourceFileBackedLocatorMixin, _CacheLocator):
    """Locate the cache in a subfolder of the temporary folder, without write access for other users."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file = file
        self._lineno = function.__code__.co_firstlineno
        self._folder = Path(tempfile.gettempdir()) / f"pssf-numba-{_user_id()}"

    def ensure_cache_path(self) -> None:
        """Create the private folder and the cache folder inside it.

        Raises
        ------
        OSError
            If a folder cannot be created, or if other users can write to the private folder.
        """
        with suppress(FileExistsError):
            self._folder.mkdir(mode=0o700)
        _require_private_folder(self._folder)
        super().ensure_cache_path()

    def get_cache_path(self) -> str:
        """Return the path of the cache folder of the source file."""
        return str(self._folder / self.get_suitable_cache_subpath(self._py_file))


def _user_id() -> str:
    """Return the numeric user id as text, or "user" on systems without user ids."""
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def _require_private_folder(folder: Path) -> None:
    """Raise PermissionError if another user owns a folder or can write to it, because cached code is executed."""
    state = folder.lstat()
    own = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    if not (stat.S_ISDIR(state.st_mode) and own):
        raise PermissionError(f"another user can write to folder {folder}")


class _CacheFiles(CompileResultCacheImpl):  # type: ignore[misc]
    """Choose the cache folder in the same order as numba, with the temporary folder as the last choice."""

    _locator_classes = [*CompileResultCacheImpl._locator_classes, _TemporaryLocator]  # noqa: RUF012  numba reads this attribute as a list.


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Store compiled code with its type signature and a hash, and load the code only if both match.

    Two processes that compile a function for different types at the same time choose the same file name. The type
    signature identifies the correct code.
    """

    def _load_index(self) -> Any:
        """Load the index of the cache; return an empty index if the file is damaged."""
        # pickle can raise any exception for a damaged index. The next save writes a new index.
        with suppress(Exception):
            return super()._load_index()
        return {}

    def save(self, key: Any, data: Any) -> None:
        """Save compiled code together with its key and the SHA-256 hash of both."""
        content = self._dump((key, data))
        super().save(key, (hashlib.sha256(content).digest(), content))

    def load(self, key: Any) -> Any:
        """Load compiled code; return None unless its hash and key are correct."""
        held = super().load(key)
        if held is None:
            return None
        digest, content = held
        if digest != hashlib.sha256(content).digest():
            return None
        written_for, data = pickle.loads(content)
        return data if written_for == key else None


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Store the compiled code of one function on disk; treat any failure as a cache miss.

    Parameters
    ----------
    function : callable
        Python function to be compiled.

    Raises
    ------
    RuntimeError
        If no folder is writable (raised by numba at construction).
    """

    _impl_class = _CacheFiles

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the compiled code for a signature.

        Parameters
        ----------
        sig : numba signature
            Types of the arguments.
        target_context : numba target context
            Processor for which the code is compiled.

        Returns
        -------
        Any
            The compiled code; None if no code is stored or the file is damaged.
        """
        with suppress(Exception):  # pickle can raise any exception for a damaged file.
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the compiled code for a signature; do nothing if the file cannot be written.

        Parameters
        ----------
        sig : numba signature
            Types of the arguments.
        data : Any
            Compiled code.
        """
        with suppress(Exception):
            super().save_overload(sig, data)
