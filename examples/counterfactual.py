"""One knee twice: two millimetres of medial joint space less, everything else and the noise held fixed."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.files.pictures import side_by_side


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write both radiographs and their difference as one PNG; `pixels` is the side of the detector."""
    knee = pssf.Knee(jsw_medial_mm=5.0, grade=0)
    narrow = dataclasses.replace(knee, jsw_medial_mm=3.0)
    reference = pssf.load_protocol("reference")
    protocol = dataclasses.replace(reference, rows=pixels, cols=pixels, pixel_mm=307.2 / pixels)
    pair = [pssf.simulate(each, protocol, seed=1).pixels for each in (knee, narrow)]
    change = np.log(pair[1].astype(float) + 1) - np.log(pair[0].astype(float) + 1)
    grey = np.clip(128 + 160 * change, 0, 255).astype(np.uint8)
    half = slice(pixels // 4, pixels - pixels // 4)
    shown = [pssf.present(each) for each in pair]
    return [side_by_side([image[half, half] for image in (*shown, grey)], out / "counterfactual.png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
