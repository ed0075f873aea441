"""Sample the knee of one woman with KL grades 0, 2 and 4; draw its medial joint space and bone path length."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

# Width of a column in pixels, and path length of the brightest colour in the map of cortical bone, in mm.
COLS, MAXIMUM_MM = 400, 20.0


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write each knee above its enlarged medial joint space as one PNG; the detector has `pixels` x `pixels` pixels."""
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    columns = []
    for grade in (0, 2, 4):
        knee = pssf.sample_knee(grade=grade, rng=3, side="right", sex="female")
        radiograph = pssf.simulate(knee, protocol, rng=grade, keep=("path_mm",))
        joint = radiograph.truth.medial_joint_line_px
        caption = f"KL {grade}, medial JSW {radiograph.truth.jsw_medial_mm:.1f} mm"
        image = pssf.render_for_display(radiograph, processing="processed")
        columns.append(make_column(image, joint, protocol.pixel_mm, caption))
    # An exponent below 1 makes the thin cortex at the joint visible next to the thick cortex of the shafts.
    paths = apply_heat_map((radiograph.kept["path_mm"]["cortical_bone"] / MAXIMUM_MM) ** 0.6, 1.0)
    columns.append(make_column(paths, joint, protocol.pixel_mm, f"path in cortical bone, 0 to {MAXIMUM_MM:g} mm"))
    return [write_image_row(columns, out / "knees.png")]


def make_column(image: np.ndarray, joint: tuple[float, float], pixel_mm: float, caption: str) -> np.ndarray:
    """Stack the middle of an image (rows, cols) and the medial compartment around its joint line (row, col)."""
    rows, cols = image.shape[:2]
    whole = image[rows * 12 // 100 : rows * 86 // 100, cols * 20 // 100 : cols * 80 // 100]
    row, col, half = round(joint[0]), round(joint[1] + 6.0 / pixel_mm), round(31.0 / pixel_mm)
    compartment = image[row - half * 7 // 10 : row + half * 7 // 10, col - half : col + half]
    gap = np.full((8, COLS, 3), 255, np.uint8)
    return np.vstack(
        [make_panel(whole, COLS * 37 // 30, COLS, caption), gap, make_panel(compartment, COLS * 7 // 10, COLS)]
    )


if __name__ == "__main__":
    run(Path(__file__).parent)
