"""Log a message when the first kernel is compiled, because the compilation delays the process by several seconds.

numba stores compiled code on disk, so compilation happens once per installation or change of the code. Importing this
module registers the event listener.
"""

import logging
from multiprocessing import parent_process
from typing import Any

from numba.core import event

_LOG = logging.getLogger("pssf")
_MESSAGE = (
    "pssf: compiling numerical kernels for this processor; this takes 8 to 30 s and happens once after an installation"
)


class _FirstCompilationLogger(event.Listener):
    """Log the first compilation of a kernel of this package, except in worker processes."""

    def __init__(self) -> None:
        self.was_logged = False

    def on_start(self, event: Any) -> None:
        """Log the message if a kernel of this package is compiled for the first time."""
        module = getattr(event.data["dispatcher"].py_func, "__module__", "") or ""
        # parent_process() is not called earlier, because a worker process imports this module before its parent is
        # known.
        if not self.was_logged and parent_process() is None and module.split(".")[0] == "pssf":
            self.was_logged = True
            # The level is WARNING, which Python prints even if logging is not configured.
            _LOG.warning(_MESSAGE)

    def on_end(self, event: Any) -> None:
        """Do nothing: only the start of a compilation is logged."""


event.register("numba:compile", _FirstCompilationLogger())
