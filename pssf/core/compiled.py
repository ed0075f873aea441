"""kernel, callee: how numba compiles functions.

Compiled code is kept on disk, beside the source, in the user's cache folder or in a temporary one (`kernel_cache`);
after an installation it is waited for. So nothing is compiled that nobody calls: no entry from C, and none from Python
where other compiled functions alone call, which would be as much work as the function itself.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit
from numba.core.dispatcher import Dispatcher

from . import compile_notice  # noqa: F401  logs a line where a kernel has to be compiled
from .kernel_cache import cache_of

# Called from compiled functions alone, and kept as a part of these. There is no entry: a call from Python crashes.
callee = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that is called from Python, and keep the code on disk.

    Parameters
    ----------
    **options
        Further options of `numba.njit`.

    Returns
    -------
    Decorator of the function. Of a division by 0 numpy's rule is taken, which needs no branch.
    """
    compiled = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(**options)

    def cached(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if isinstance(dispatcher, Dispatcher):  # the function itself where numba is told not to compile
            dispatcher._cache = cache_of(function)  # type: ignore[attr-defined]
        return dispatcher

    return cached
