"""What is known of every radiograph: outlines of bones and osteophytes, landmarks, and the joint spaces."""

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
    """Write a radiograph and its labels side by side as one PNG; `pixels` is the side of the detector."""
    knee = pssf.sample_knee(grade=2, rng=3, side="right", sex="female")
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    radiograph = pssf.simulate(knee, protocol, rng=2, keep=("masks",))
    truth = radiograph.truth
    plain = pssf.render_for_display(radiograph.pixels, processing="processed")
    drawn = np.repeat(plain[..., None], 3, axis=2)
    for name, mask in truth.masks.items():
        rim = ndimage.binary_dilation(mask, iterations=max(1, pixels // 512)) & ~mask
        drawn[rim] = COLOURS.get(name, OSTEOPHYTE)
    sheet, size = Image.fromarray(drawn), pixels / 200
    for row, col in truth.landmarks_px.values():
        place = (col - size, row - size, col + size, row + size)
        ImageDraw.Draw(sheet).ellipse(place, fill="white", outline="black")
    part = np.s_[pixels * 2 // 10 : pixels * 8 // 10, pixels // 4 : pixels * 3 // 4]
    told = f"joint space: medial {truth.jsw_medial_mm:.1f}, lateral {truth.jsw_lateral_mm:.1f} mm"
    shown = [
        make_panel(plain[part], ROWS, COLS, f"KL {truth.grade}"),
        make_panel(np.asarray(sheet)[part], ROWS, COLS, told),
    ]
    return [write_image_row(shown, out / "labels.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
