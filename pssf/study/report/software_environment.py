"""Software and hardware on which a study was run."""

import os
import platform
from importlib.metadata import distributions
from typing import Any


def describe_environment() -> dict[str, Any]:
    """Describe Python, the machine and all installed packages.

    Returns
    -------
    dict of str to Any
        Entries python, system, machine, cores, and packages (version of each package by name).
    """
    installed = {one.metadata["Name"]: one.version for one in distributions()}
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "packages": dict(sorted(installed.items(), key=lambda pair: pair[0].lower())),
    }
