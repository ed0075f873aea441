"""Simulate one knee under five protocols: reference, low dose, shifted geometry, large focal spot, and grid."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

PROTOCOLS = ("reference", "low_dose", "geometry_shift", "large_focus", "scatter_grid")
SIDE = 400


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the medial compartment under each protocol as one PNG; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.sample_knee(grade=2, rng=3, side="right", sex="female")
    built = pssf.build(knee)
    panels = []
    for name in PROTOCOLS:
        protocol = pssf.load_protocol(name).resample(pixels)
        radiograph = pssf.simulate(built, protocol, rng=1)
        row, col = (round(value) for value in radiograph.truth.medial_joint_line_px)
        half = round(30.0 / protocol.pixel_mm)
        compartment = pssf.render_for_display(radiograph.pixels, processing="processed")[
            row - half : row + half, col - half : col + half
        ]
        panels.append(make_panel(compartment, SIDE, SIDE, name.replace("_", " ")))
    panels.append(np.full_like(panels[0], 255))
    columns = [np.vstack(panels[first::3]) for first in range(3)]
    return [write_image_row(columns, out / "protocols.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
