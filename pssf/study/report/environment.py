"""What a study ran on: Python, machine, every installed package."""

import os
import platform
from importlib.metadata import distributions
from typing import Any


def environment() -> dict[str, Any]:
    """python, system, machine, cores, and packages: name -> version of all that is installed"""
    installed = {one.metadata["Name"]: one.version for one in distributions()}
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "packages": dict(sorted(installed.items(), key=lambda pair: pair[0].lower())),
    }
