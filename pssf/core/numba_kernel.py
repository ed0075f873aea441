"""Decorators that compile functions with numba and cache the code on disk.

Compiled code is kept beside the source, in the user's cache folder or in a temporary folder (`kernel_cache`). The first
call after an installation waits for the compilation. To shorten this wait, no wrapper for C is compiled. Functions that
only compiled functions call (`kernel_helper`) get no wrapper for Python either: it would take as long as the function.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit
from numba.core.dispatcher import Dispatcher

from . import compile_notice  # noqa: F401  The import registers the log message at the first compilation.
from .kernel_cache import make_kernel_cache

# Decorator of functions that only compiled functions call; their code is cached as a part of the caller's.
# Such a function has no wrapper for Python: a call from Python crashes.
kernel_helper = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that is called from Python so that it is compiled, and cached on disk.

    Parameters
    ----------
    **options : Any
        Further options of `numba.njit`.

    Returns
    -------
    callable
        The decorator. In the compiled function a division by 0 follows numpy's rule, which needs no branch.
    """
    compiled = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(**options)

    def cached(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if isinstance(dispatcher, Dispatcher):  # With NUMBA_DISABLE_JIT numba returns the plain function instead.
            dispatcher._cache = make_kernel_cache(function)  # type: ignore[attr-defined]
        return dispatcher

    return cached
