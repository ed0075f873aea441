"""Fifteen drawn knees in fixed flexion: three of each KL grade, as different from one another as people are."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

ROWS, COLS, HALF_MM = 360, 330, (60.0, 55.0)


def run(out: Path, pixels: int = 1024, each: int = 3) -> list[Path]:
    """Write the picture; `pixels` is the side of the detector, `each` how many knees of a grade."""
    view = pssf.load_protocol("fixed_flexion")
    protocol = view.resample(pixels)
    columns = []
    for grade in range(5):
        chance = [np.random.default_rng(10 * number + grade) for number in range(each)]
        knees = [pssf.sample_knee(grade=grade, rng=rng, grade_table="population") for rng in chance]
        columns.append(np.vstack([shown(knee, protocol) for knee in knees]))
    return [write_image_row(columns, out / "people.png")]


def shown(knee: pssf.Knee, protocol: pssf.Protocol) -> np.ndarray:
    """The middle of a knee's radiograph, as a picture."""
    radiograph = pssf.simulate(knee, protocol, rng=1)
    magnified = protocol.sdd_mm / protocol.sod_mm / protocol.pixel_mm
    (row, col), (tall, wide) = radiograph.truth.landmarks_px["joint_centre"], (half * magnified for half in HALF_MM)
    part = pssf.render_for_display(radiograph.pixels, processing="processed")[
        round(row - tall) : round(row + tall), round(col - wide) : round(col + wide)
    ]
    return make_panel(part, ROWS, COLS, f"KL {knee.grade}, {knee.sex}, {knee.side}")


if __name__ == "__main__":
    run(Path(__file__).parent)
