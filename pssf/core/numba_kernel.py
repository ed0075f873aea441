"""Compile functions with numba, and cache the compiled code on disk.

Compiled code is stored in the source folder, the user's cache folder or a temporary folder (`kernel_cache`). The first
call after an installation includes the compilation. To shorten the compilation, no C wrapper is generated. Functions
that are called only by compiled functions (`kernel_helper`) also have no Python wrapper, because the wrapper takes as
long to compile as the function.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit
from numba.core.dispatcher import Dispatcher

from . import compile_notice  # noqa: F401  The import registers the log message at the first compilation.
from .kernel_cache import make_kernel_cache

# Decorator for functions that are called only by compiled functions; their code is cached with the code of the caller.
# The decorated function has no Python wrapper, so a call from Python crashes.
kernel_helper = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a decorator that compiles a function for calls from Python, and caches the compiled code on disk.

    Parameters
    ----------
    **options : Any
        Additional options of `numba.njit`.

    Returns
    -------
    callable
        Decorator. Division by 0 in the compiled function gives inf or nan as in numpy, so no branch is compiled.
    """
    compiled = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(**options)

    def cached(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if isinstance(dispatcher, Dispatcher):  # If NUMBA_DISABLE_JIT is set, numba returns the Python function.
            dispatcher._cache = make_kernel_cache(function)  # type: ignore[attr-defined]
        return dispatcher

    return cached
