"""One knee in seven views: from the front, straight and bent, from the side, along the thigh, and both at once."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

VIEWS = ("ap_standing", "fixed_flexion", "lyon_schuss", "rosenberg", "lateral", "skyline", "bilateral")
WIDTH_PX = 1600
# What is shown of each film, mm about its centre; of both knees at once all that there is.
SHOWN_MM = {"skyline": (240.0, 106.0), "bilateral": (430.0, 350.0)}
WIDTH_MM, HEIGHT_MM = 150.0, 210.0


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a woman's knee, and both, in all views as one PNG; `pixels` is the side of the reference's detector."""
    right = pssf.sample_knee(grade=1, rng=3, grade_table="population", side="right", sex="female", rotation_deg=0.0)
    left = dataclasses.replace(right, side="left", texture_seed=right.texture_seed + 1)
    shown = []
    for name in VIEWS:
        known = pssf.load_protocol(name)
        coarser = 2048 / pixels
        protocol = dataclasses.replace(
            known,
            rows=round(known.rows / coarser),
            cols=round(known.cols / coarser),
            pixel_mm=known.pixel_mm * coarser,
            scatter_photons=round(known.scatter_photons / coarser),
        )
        radiograph = pssf.simulate(
            (right, left) if known.knee_distance_mm else right, protocol, rng=1, engine="scanline"
        )
        seen = pssf.render_for_display(radiograph.pixels)
        lengths = SHOWN_MM.get(name, (WIDTH_MM, HEIGHT_MM))
        wide, high = (
            min(round(mm / protocol.pixel_mm), side) for mm, side in zip(lengths, seen.shape[::-1], strict=True)
        )
        row, col = (seen.shape[0] - high) // 2, (seen.shape[1] - wide) // 2
        shown.append(seen[row : row + high, col : col + wide])
    page = np.vstack([row_of(shown[:5], VIEWS[:5]), row_of(shown[5:], VIEWS[5:])])
    return [write_image_row([page], out / "views.png")]


def row_of(images: list[np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """Images of any size at one height, beside each other, as wide as the page."""
    shares = [image.shape[1] / image.shape[0] for image in images]
    rows = round(WIDTH_PX / sum(shares))
    cols = [round(rows * share) for share in shares[:-1]]
    cols.append(WIDTH_PX - sum(cols))
    return np.hstack([
        make_panel(image, rows, wide, name.replace("_", " "))
        for image, wide, name in zip(images, cols, names, strict=True)
    ])  # fmt: skip


if __name__ == "__main__":
    run(Path(__file__).parent)
