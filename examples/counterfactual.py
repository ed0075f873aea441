"""One knee changed in one thing at a time, its trabeculae and the noise held fixed, and what that changes in the image.

Two millimetres of medial joint space less; then, instead, osteophytes at the medial margins. The joint line stays in
the middle of the image, so that a narrower space moves both bones, each with its trabeculae.
"""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import side_by_side


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the radiograph, both changed ones and the differences as one PNG; `pixels` is the side of the detector."""
    knee = pssf.Knee(texture_seed=4)
    beaks = tuple(pssf.Osteophyte(site=site, size_mm=2.5) for site in ("medial_femur", "medial_tibia"))
    changed = [dataclasses.replace(knee, jsw_medial_mm=3.0), dataclasses.replace(knee, osteophytes=beaks)]
    reference = pssf.load_protocol("reference")
    protocol = dataclasses.replace(reference, rows=pixels, cols=pixels, pixel_mm=307.2 / pixels)
    before, *after = (pssf.simulate(each, protocol, seed=1).pixels for each in (knee, *changed))
    shown = [pssf.present(before)]
    for image in after:
        change = np.log(image + 1.0) - np.log(before + 1.0)
        shown += [pssf.present(image), np.clip(128 + 200 * change, 0, 255).astype(np.uint8)]
    joint = (slice(pixels * 5 // 16, pixels * 11 // 16), slice(pixels * 5 // 16, pixels * 11 // 16))
    return [side_by_side([image[joint] for image in shown], out / "counterfactual.png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
