"""The picture at the top of the README: a knee of each grade, and path lengths in its bones."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import side_by_side


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the picture; `pixels` is the side of the detector."""
    reference = pssf.load_protocol("reference")
    protocol = dataclasses.replace(reference, rows=pixels, cols=pixels, pixel_mm=307.2 / pixels)
    images = []
    for grade in (0, 1, 2):
        knee = pssf.draw_knee(grade=grade, rng=np.random.default_rng(11), side="right", sex="female")
        radiograph = pssf.simulate(knee, protocol, seed=grade, keep=("path_mm",))
        images.append(pssf.present(radiograph.pixels))
    bone = radiograph.kept["path_mm"]["cortical_bone"] + 0.4 * radiograph.kept["path_mm"]["trabecular_bone"]
    images.append(np.clip(255 * (bone / 45.0) ** 0.7, 0, 255).astype(np.uint8))
    rows, cols = slice(pixels // 8, pixels - pixels // 8), slice(pixels // 5, pixels - pixels // 5)
    step = max(1, pixels // 1024)
    return [side_by_side([image[rows, cols][::step, ::step] for image in images], out / "knees.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
