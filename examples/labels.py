"""Draw the labels of a radiograph on the image: outlines of bones and osteophytes, landmarks and joint spaces."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

import pssf
from pssf.io.pictures import make_panel, write_image_row

COLOURS = {
    "femur": (90, 200, 250),
    "tibia": (255, 200, 60),
    "fibula": (150, 220, 120),
    "patella": (230, 140, 255),
    "fabella": (255, 255, 255),
}
OSTEOPHYTE = (255, 70, 70)
ROWS, COLS = 720, 600


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a radiograph and its labels side by side as one PNG; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.sample_knee(grade=2, rng=3, side="right", sex="female")
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    radiograph = pssf.simulate(knee, protocol, rng=2, keep=("masks",))
    truth = radiograph.truth
    image = pssf.render_for_display(radiograph.pixels, processing="processed")
    coloured = np.repeat(image[..., None], 3, axis=2)
    for name, mask in truth.masks.items():
        rim = ndimage.binary_dilation(mask, iterations=max(1, pixels // 512)) & ~mask
        coloured[rim] = COLOURS.get(name, OSTEOPHYTE)
    overlay, radius = Image.fromarray(coloured), pixels / 200
    for row, col in truth.landmarks_px.values():
        box = (col - radius, row - radius, col + radius, row + radius)
        ImageDraw.Draw(overlay).ellipse(box, fill="white", outline="black")
    window = np.s_[pixels * 2 // 10 : pixels * 8 // 10, pixels // 4 : pixels * 3 // 4]
    caption = f"JSW: medial {truth.jsw_medial_mm:.1f} mm, lateral {truth.jsw_lateral_mm:.1f} mm"
    panels = [
        make_panel(image[window], ROWS, COLS, f"KL {truth.grade}"),
        make_panel(np.asarray(overlay)[window], ROWS, COLS, caption),
    ]
    return [write_image_row(panels, out / "labels.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
