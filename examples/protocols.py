"""One knee, five ways to take it: what a technique changes while the knee stays the same."""

from pathlib import Path

import pssf
from pssf.io.pictures import make_panel, write_image_row

PROTOCOLS = ("reference", "low_dose", "geometry_shift", "large_focus", "scatter_grid")
SIDE = 320


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the medial compartment under each protocol as one PNG; `pixels` is the side of the detector."""
    knee = pssf.sample_knee(grade=2, rng=3, side="right", sex="female")
    built = pssf.build(knee)
    shown = []
    for name in PROTOCOLS:
        protocol = pssf.load_protocol(name).resample(pixels)
        radiograph = pssf.simulate(built, protocol, rng=1)
        row, col = (round(place) for place in radiograph.truth.medial_joint_line_px)
        half = round(30.0 / protocol.pixel_mm)
        near = pssf.render_for_display(radiograph.pixels, processing="processed")[
            row - half : row + half, col - half : col + half
        ]
        shown.append(make_panel(near, SIDE, SIDE, name.replace("_", " ")))
    return [write_image_row(shown, out / "protocols.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
