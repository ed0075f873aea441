"""kernel, callee: how numba compiles functions.

Compiled code is kept by numba, beside the source or in the user's cache folder; after an installation it is waited for.
So nothing is compiled that nobody calls: no entry from C, and none from Python where other compiled functions alone
call, which would be as much work as the function itself.
"""

from functools import partial

from numba import njit

from . import compile_notice  # noqa: F401  logs a line where a kernel has to be compiled

# Called from Python. Of a division by 0 numpy's rule is taken, which needs no branch.
kernel = partial(njit, cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
# Called from compiled functions alone, and kept as a part of these. There is no entry: a call from Python crashes.
callee = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)
