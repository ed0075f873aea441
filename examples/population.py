"""Sample fifteen knees, three of each KL grade, and show their radiographs in fixed flexion."""

from pathlib import Path

import msgspec
import numpy as np

import pssf
from pssf.data.imaging.display_table import load_display_processing
from pssf.io.pictures import make_panel, write_image_row

# Rows and columns of a panel in pixels; half height and half width of the window around the joint in mm.
ROWS, COLS, HALF_MM = 360, 330, (60.0, 55.0)
# The latitude gain is lower and the grey-scale window wider than by default, because the default loses the texture of
# the condyles where the patella overlaps them.
WINDOW = {"latitude_gain": 0.7, "dark": 0.2, "bright": 0.99, "bend": 0.25}


def run(out: Path, pixels: int = 1024, knees_per_grade: int = 3) -> list[Path]:
    """Write a PNG with one column per grade; the detector has `pixels` x `pixels` pixels."""
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    columns = []
    for grade in range(5):
        knees = [pssf.sample_knee(grade=grade, rng=10 * number + grade) for number in range(knees_per_grade)]
        columns.append(np.vstack([make_radiograph_panel(knee, protocol) for knee in knees]))
    return [write_image_row(columns, out / "population.png")]


def make_radiograph_panel(knee: pssf.Knee, protocol: pssf.Protocol) -> np.ndarray:
    """Simulate a knee, and crop the radiograph to a window around the joint."""
    radiograph = pssf.simulate(knee, protocol, rng=1)
    px_per_mm = protocol.sdd_mm / protocol.sod_mm / protocol.pixel_mm
    row, col = radiograph.truth.landmarks_px["joint_centre"]
    high, wide = (mm * px_per_mm for mm in HALF_MM)
    processing = msgspec.structs.replace(load_display_processing().processed, **WINDOW)
    image = pssf.render_for_display(radiograph, processing=processing)
    window = image[round(row - high) : round(row + high), round(col - wide) : round(col + wide)]
    return make_panel(window, ROWS, COLS, f"KL {knee.grade}, {knee.sex}, {knee.side}")


if __name__ == "__main__":
    run(Path(__file__).parent)
