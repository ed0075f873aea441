"""Advance computation of X-ray spectra for the tube-voltage slider, in a separate low-priority process."""

import os
import signal
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from ..core.processes.child_processes import start_without_working_folder
from ..data.imaging.explore_table import load_page_settings
from ..model.protocol import load_protocol

# Nice value for the lowest process priority on Unix.
_NICE_LEVEL = 19


def start_spectrum_prefetch(protocol_name: str = "reference") -> Any:
    """Start a process that computes X-ray spectra at all integer tube voltages in kV.

    Parameters
    ----------
    protocol_name : str, default "reference"
        Name of the protocol that defines anode angle and filtration of the tube.

    Returns
    -------
    Process
        The started process, which the caller must end.

    Notes
    -----
    The spectra are stored in the cache folder of the user. SpekPy needs several tenths of a second for a new voltage,
    which is too slow for interactive use of the slider.
    """
    process = get_context("spawn").Process(target=compute_spectra, args=(protocol_name,), daemon=True)
    with start_without_working_folder():
        process.start()
    return process


def compute_spectra(protocol_name: str) -> None:
    """Compute X-ray spectra at all integer tube voltages, starting near the voltage of the protocol.

    Parameters
    ----------
    protocol_name : str
        Name of the protocol that defines tube voltage, anode angle and filtration.
    """
    # Ctrl-C in the terminal also reaches this process. The signal is ignored, because the server kills the process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):
        os.nice(_NICE_LEVEL)
    from ..xray.spectrum import tube_spectrum

    tube = load_protocol(protocol_name)
    low, high = load_page_settings().slider["tube_kv"]
    for kv in sorted(range(int(low), int(high) + 1), key=lambda kv: abs(kv - tube.tube_kv)):
        tube_spectrum(float(kv), tube.anode_angle_deg, tube.filtration_mm_al)
