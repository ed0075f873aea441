"""One line of log where a process first compiles a kernel of this package: it then waits for some seconds.

numba keeps what it has compiled, so that this happens once after an installation or a change of the code.
"""

import logging
from multiprocessing import parent_process
from typing import Any

from numba.core import event

_LOG = logging.getLogger("pssf")
_SAID = (
    "pssf: compiling numerical kernels for this processor; this takes 8 to 30 s and happens once after an installation"
)


class _FirstOfPackage(event.Listener):
    """Log the first compilation of a kernel of this package, unless this is a worker process."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: Any) -> None:
        module = getattr(event.data["dispatcher"].py_func, "__module__", "") or ""
        # Asked now: a process that is being started reads this module before it knows that it has a parent.
        if not self.said and parent_process() is None and module.split(".")[0] == "pssf":
            self.said = True
            # A warning, which Python shows without any set-up of logging.
            _LOG.warning(_SAID)

    def on_end(self, event: Any) -> None:
        """Do nothing."""


event.register("numba:compile", _FirstOfPackage())
