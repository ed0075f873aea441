"""Ahead: spectra of a tube that a kV slider will ask for, computed by a process of their own while nobody waits."""

import os
import signal
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from ..core.child_processes import safe_start
from ..data.fields import field_laws
from ..model.protocol import load_protocol

_NICE = 19


def start_spectra(protocol: str = "reference") -> Any:
    """A process that computes the spectra of a protocol's tube at all whole kV; they stay in the user's cache folder.

    SpekPy takes some tenths of a second for a voltage that is new, longer than an exposure slider should.
    """
    process = get_context("spawn").Process(target=compute_spectra, args=(protocol,), daemon=True)
    with safe_start():
        process.start()
    return process


def compute_spectra(protocol: str) -> None:
    """All of them, from the protocol's own voltage outwards; what runs in the process."""
    # The terminal's Ctrl-C is the server's, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):
        os.nice(_NICE)
    from ..xray.spectrum import tube_spectrum

    tube = load_protocol(protocol)
    law = field_laws("protocol")["tube_kv"].range
    assert law is not None
    for kv in sorted(range(int(law[0]), int(law[1]) + 1), key=lambda kv: abs(kv - tube.tube_kv)):
        tube_spectrum(float(kv), tube.anode_angle_deg, tube.filtration_mm_al)
