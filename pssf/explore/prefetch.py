"""Prefetch of X-ray spectra for the tube-voltage slider, in a separate low-priority process."""

import os
import signal
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from ..core.processes.child_processes import start_without_working_folder
from ..data.knees.field_definitions import load_field_specs
from ..model.protocol import load_protocol

# Lowest process priority of Unix.
_NICE_LEVEL = 19


def start_spectrum_prefetch(protocol_name: str = "reference") -> Any:
    """Start a process that computes the spectra of a tube at all integer voltages in kV.

    Parameters
    ----------
    protocol_name : str, default "reference"
        Protocol that gives anode angle and filtration.

    Returns
    -------
    Process
        Started process.

    Notes
    -----
    The spectra are stored in the cache folder of the user. SpekPy needs some tenths of a second for a new voltage,
    which is too long for an exposure slider.
    """
    process = get_context("spawn").Process(target=compute_spectra, args=(protocol_name,), daemon=True)
    with start_without_working_folder():
        process.start()
    return process


def compute_spectra(protocol_name: str) -> None:
    """Compute the spectra of a tube, starting at the voltage of the protocol; this function runs in the process.

    Parameters
    ----------
    protocol_name : str
        Protocol that gives tube voltage, anode angle and filtration.
    """
    # Ctrl-C in the terminal also reaches this process. Ignore it, because the server ends the process itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):
        os.nice(_NICE_LEVEL)
    from ..xray.spectrum import tube_spectrum

    tube = load_protocol(protocol_name)
    law = load_field_specs("protocol")["tube_kv"].range
    assert law is not None
    for kv in sorted(range(int(law[0]), int(law[1]) + 1), key=lambda kv: abs(kv - tube.tube_kv)):
        tube_spectrum(float(kv), tube.anode_angle_deg, tube.filtration_mm_al)
