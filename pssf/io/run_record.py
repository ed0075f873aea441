"""Record of the command, date, machine and machine load of a run, stored in the output folder."""

import os
import platform
import shlex
import sys
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

from ..core.processes.parallel_map import count_cores
from .cohort_records import write_json

# Name of the run record file in the output folder.
RUN_FILE = "run.json"


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Record of the command, date and machine of a run.

    Attributes
    ----------
    command : str
        Command line, such as ``pssf validate --tables knees --out runs/knees``.
    date : str
        Date of the run, such as 2026-11-22.
    machine : str
        Description of the machine; see `describe_machine`.
    note : str
        Additional remark; empty if there is none.
    """

    command: str
    date: str
    machine: str
    note: str

    def save(self, folder: Path) -> Path:
        """Write the run record to ``run.json``.

        Parameters
        ----------
        folder : Path
            Output folder of the run.

        Returns
        -------
        Path
            Path of ``run.json``.

        Raises
        ------
        InputError
            The disk is full, or the file cannot be written.
        """
        write_json(folder / RUN_FILE, asdict(self))
        return folder / RUN_FILE


def describe_machine() -> str:
    """Describe the machine by usable cores, processor, operating system and Python version.

    Returns
    -------
    str
        One-line description of the machine, for a caption.
    """
    processor = platform.machine().replace("_", "-")
    release = ".".join(platform.python_version_tuple()[:2])
    return f"{count_cores()} cores, {processor}, {platform.system()}, Python {release}"


def start_run_record() -> RunRecord:
    """Create the record of a command-line run.

    The function must be called before the run starts, because the run increases the machine load.

    Returns
    -------
    RunRecord
        Run record, which the caller must save when the run is complete.
    """
    # Windows does not provide a load average.
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return RunRecord(
        command=shlex.join(["pssf", *sys.argv[1:]]),
        date=date.today().isoformat(),
        machine=describe_machine(),
        note="beside other work" if load > count_cores() / 2 else "",
    )
