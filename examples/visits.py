"""One knee at three visits, each taken anew: joint space, osteophytes and plate go on, the rest is the same knee."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

YEARS = (0.0, 6.0, 12.0)
ROWS, COLS, HALF_MM = 520, 480, (60.0, 55.0)


def run(out: Path, pixels: int = 1024) -> list[Path]:
    """Write the visits side by side as one PNG; `pixels` is the side of the detector."""
    view = pssf.load_protocol("fixed_flexion")
    protocol = view.resample(pixels)
    first = pssf.sample_knee(grade=2, rng=8, grade_table="population", side="right")
    shown = []
    for visit, years in enumerate(YEARS):
        # One seed, one course: each time is a visit of it.
        knee = pssf.progress(first, years, np.random.default_rng(8))
        change = pssf.true_change(first, knee)
        taking = pssf.sample_acquisition(protocol, rng=np.random.default_rng([8, visit]), side=knee.side)
        radiograph = pssf.simulate(knee, taking, rng=visit)
        magnified = taking.sdd_mm / taking.sod_mm / taking.pixel_mm
        (row, col), (tall, wide) = radiograph.truth.landmarks_px["joint_centre"], (mm * magnified for mm in HALF_MM)
        part = np.s_[round(row - tall) : round(row + tall), round(col - wide) : round(col + wide)]
        told = f"year {years:g}: KL {knee.grade}, medial {change['jsw_medial_mm']:+.1f} mm"
        within = {"pixel_mm": taking.pixel_mm, "field_mm": (taking.field_width_mm, taking.field_height_mm)}
        plain = pssf.render_for_display(radiograph.pixels, processing="processed", **within)
        shown.append(make_panel(plain[part], ROWS, COLS, told))
    return [write_image_row(shown, out / "visits.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
