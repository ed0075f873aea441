"""One knee changed in one thing at a time, its trabeculae and the noise held fixed, and what that changes in the image.

Two millimetres of medial joint space less; then, instead, osteophytes at the medial margins. The joint line stays in
the middle of the image, so that a narrower space moves both bones, each with its trabeculae.
"""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

SIDE = 320


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the radiograph, both changed ones and the differences as one PNG; `pixels` is the side of the detector."""
    knee = pssf.Knee(texture_seed=4)
    osteophytes = tuple(pssf.Osteophyte(site=site, size_mm=2.5) for site in ("medial_femur", "medial_tibia"))
    changed = {
        "space 2 mm less": dataclasses.replace(knee, jsw_medial_mm=3.0),
        "two osteophytes": dataclasses.replace(knee, osteophytes=osteophytes),
    }
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    joint = (slice(pixels * 5 // 16, pixels * 11 // 16), slice(pixels * 5 // 16, pixels * 11 // 16))
    before = pssf.simulate(knee, protocol, rng=1).pixels
    shown = [make_panel(pssf.render_for_display(before, processing="processed")[joint], SIDE, SIDE, "healthy")]
    for what, other in changed.items():
        after = pssf.simulate(other, protocol, rng=1).pixels
        change = np.clip(128 + 200 * (np.log(after + 1.0) - np.log(before + 1.0)), 0, 255).astype(np.uint8)
        shown += [
            make_panel(pssf.render_for_display(after, processing="processed")[joint], SIDE, SIDE, what),
            make_panel(change[joint], SIDE, SIDE, "what changed"),
        ]
    return [write_image_row(shown, out / "counterfactual.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
