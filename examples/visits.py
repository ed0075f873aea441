"""Simulate one knee at three visits, each with its own acquisition; joint space, osteophytes and bone plate change."""

from pathlib import Path

import msgspec
import numpy as np

import pssf
from pssf.data.imaging.display_table import load_display_processing
from pssf.io.pictures import make_panel, write_image_row

YEARS = (0.0, 6.0, 12.0)
# Rows and columns of a panel in pixels; half height and half width of the window around the joint in mm.
ROWS, COLS, HALF_MM = 520, 480, (60.0, 55.0)
# The latitude gain is lower and the grey-scale window wider than by default, because the default loses the texture of
# the condyles where the patella overlaps them.
WINDOW = {"latitude_gain": 0.7, "dark": 0.2, "bright": 0.99, "bend": 0.25}


def run(out: Path, pixels: int = 1024) -> list[Path]:
    """Write the visits side by side as one PNG; the detector has `pixels` x `pixels` pixels."""
    nominal = pssf.load_protocol("fixed_flexion").resample(pixels)
    first = pssf.sample_knee(grade=2, rng=8, side="right")
    panels = []
    processing = msgspec.structs.replace(load_display_processing().processed, **WINDOW)
    for visit, years in enumerate(YEARS):
        # Calls with the same seed and different years give successive visits along one course of progression.
        knee = pssf.progress(first, years, np.random.default_rng(8))
        change = pssf.true_change(first, knee)
        protocol = pssf.sample_acquisition(nominal, rng=np.random.default_rng([8, visit]), side=knee.side)
        radiograph = pssf.simulate(knee, protocol, rng=visit)
        px_per_mm = protocol.sdd_mm / protocol.sod_mm / protocol.pixel_mm
        row, col = radiograph.truth.landmarks_px["joint_centre"]
        high, wide = (mm * px_per_mm for mm in HALF_MM)
        window = np.s_[round(row - high) : round(row + high), round(col - wide) : round(col + wide)]
        caption = f"year {years:g}: KL {knee.grade}, JSW change {change['jsw_medial_mm']:+.1f} mm"
        image = pssf.render_for_display(radiograph, processing=processing)
        panels.append(make_panel(image[window], ROWS, COLS, caption))
    return [write_image_row(panels, out / "visits.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
