"""Decorators that compile functions with numba and cache the code on disk.

Compiled code is stored in the source folder, the user's cache folder or a temporary folder (`kernel_cache`). The first
call after an installation waits for the compilation. To shorten the wait, no wrapper for C is compiled. Functions that
only compiled functions call (`kernel_helper`) also get no wrapper for Python, because it takes as long to compile as
the function.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit
from numba.core.dispatcher import Dispatcher

from . import compile_notice  # noqa: F401  The import registers the log message at the first compilation.
from .kernel_cache import make_kernel_cache

# Decorator of functions that only compiled functions call; their code is cached with the code of the caller.
# A decorated function has no wrapper for Python, so a call from Python crashes.
kernel_helper = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a decorator that compiles a function which Python calls, and caches the compiled code on disk.

    Parameters
    ----------
    **options : Any
        Further options of `numba.njit`.

    Returns
    -------
    callable
        The decorator. In the compiled function a division by 0 gives inf or nan, as in numpy, which needs no branch.
    """
    compiled = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(**options)

    def cached(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if isinstance(dispatcher, Dispatcher):  # With NUMBA_DISABLE_JIT numba returns the plain function instead.
            dispatcher._cache = make_kernel_cache(function)  # type: ignore[attr-defined]
        return dispatcher

    return cached
