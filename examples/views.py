"""Simulate one subject in seven views: extended and flexed frontal views, lateral, skyline, and both knees."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

VIEWS = ("ap_standing", "fixed_flexion", "lyon_schuss", "rosenberg", "lateral", "skyline", "bilateral")
WIDTH_PX = 1600
# Width and height of the window around the image centre, in mm on the detector, for views that need another window.
WINDOW_MM = {"skyline": (240.0, 106.0), "bilateral": (430.0, 350.0)}
WIDTH_MM, HEIGHT_MM = 150.0, 210.0


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write all views as one PNG; the pixel size of every protocol is multiplied by 2048 / `pixels`."""
    right = pssf.sample_knee(grade=1, rng=3, side="right", sex="female", rotation_deg=0.0)
    left = dataclasses.replace(right, side="left", texture_seed=right.texture_seed + 1)
    panels = []
    for name in VIEWS:
        nominal = pssf.load_protocol(name)
        coarsening = 2048 / pixels
        protocol = dataclasses.replace(
            nominal,
            rows=round(nominal.rows / coarsening),
            cols=round(nominal.cols / coarsening),
            pixel_mm=nominal.pixel_mm * coarsening,
            scatter_photons=round(nominal.scatter_photons / coarsening),
        )
        radiograph = pssf.simulate(
            (right, left) if nominal.knee_distance_mm else right, protocol, rng=1, engine="scanline"
        )
        image = pssf.render_for_display(radiograph.pixels)
        lengths = WINDOW_MM.get(name, (WIDTH_MM, HEIGHT_MM))
        wide, high = (
            min(round(mm / protocol.pixel_mm), side) for mm, side in zip(lengths, image.shape[::-1], strict=True)
        )
        row, col = (image.shape[0] - high) // 2, (image.shape[1] - wide) // 2
        panels.append(image[row : row + high, col : col + wide])
    page = np.vstack([make_row(panels[:5], VIEWS[:5]), make_row(panels[5:], VIEWS[5:])])
    return [write_image_row([page], out / "views.png")]


def make_row(images: list[np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """Scale images to a common height at which they fill the page width side by side."""
    aspects = [image.shape[1] / image.shape[0] for image in images]
    rows = round(WIDTH_PX / sum(aspects))
    cols = [round(rows * aspect) for aspect in aspects[:-1]]
    cols.append(WIDTH_PX - sum(cols))
    return np.hstack([
        make_panel(image, rows, wide, name.replace("_", " "))
        for image, wide, name in zip(images, cols, names, strict=True)
    ])  # fmt: skip


if __name__ == "__main__":
    run(Path(__file__).parent)
