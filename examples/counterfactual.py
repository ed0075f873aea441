"""Change one parameter of a knee at a time, keep trabeculae and noise, and show the difference of the images.

The first change reduces the medial joint space by 2 mm; the second adds osteophytes at the medial margins. The joint
line stays in the middle of the image, so a narrower joint space moves both bones with their trabeculae.
"""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import make_panel, write_image_row

SIDE = 400


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write three radiographs and two differences as one PNG; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.Knee(texture_seed=4)
    osteophytes = tuple(pssf.Osteophyte(site=site, size_mm=2.5) for site in ("medial_femur", "medial_tibia"))
    changed = {
        "JSW reduced by 2 mm": dataclasses.replace(knee, jsw_medial_mm=3.0),
        "two osteophytes": dataclasses.replace(knee, osteophytes=osteophytes),
    }
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    centre = slice(pixels * 5 // 16, pixels * 11 // 16)
    before = pssf.simulate(knee, protocol, rng=1).pixels
    unchanged = pssf.render_for_display(before, processing="processed")[centre, centre]
    panel = make_panel(unchanged, SIDE, SIDE, "unchanged")
    columns = [np.vstack([panel, np.full_like(panel, 255)])]
    for caption, other in changed.items():
        after = pssf.simulate(other, protocol, rng=1).pixels
        change = np.clip(128 + 200 * (np.log(after + 1.0) - np.log(before + 1.0)), 0, 255).astype(np.uint8)
        image = pssf.render_for_display(after, processing="processed")[centre, centre]
        below = make_panel(change[centre, centre], SIDE, SIDE, "difference")
        columns.append(np.vstack([make_panel(image, SIDE, SIDE, caption), below]))
    return [write_image_row(columns, out / "counterfactual.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
