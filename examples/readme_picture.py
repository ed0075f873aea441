"""The picture at the top of the README: one woman's knee as KL 0, 2 and 4, and the path through cortical bone."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

COLS, MOST_MM = 400, 20.0


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the picture: whole knees, below them the medial joint; `pixels` is the side of the detector."""
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    columns = []
    for grade in (0, 2, 4):
        knee = pssf.sample_knee(grade=grade, rng=3, side="right", sex="female")
        radiograph = pssf.simulate(knee, protocol, rng=grade, keep=("path_mm",))
        joint = radiograph.truth.medial_joint_line_px
        told = f"medial joint space {radiograph.truth.jsw_medial_mm:.1f} mm"
        columns.append(
            column(
                pssf.render_for_display(radiograph.pixels, processing="processed"),
                joint,
                protocol.pixel_mm,
                f"KL {grade}",
                told,
            )
        )
    # Drawn with a power below 1, so that the thin cortex at the joint is seen beside the shaft's.
    shown = apply_heat_map((radiograph.kept["path_mm"]["cortical_bone"] / MOST_MM) ** 0.6, 1.0)
    columns.append(column(shown, joint, protocol.pixel_mm, "path through cortical bone", f"0 to {MOST_MM:g} mm"))
    return [write_image_row(columns, out / "knees.png")]


def column(image: np.ndarray, joint: tuple[float, float], pixel_mm: float, above: str, below: str) -> np.ndarray:
    """An image (rows, cols[, 3]): the middle of it, and the medial compartment about its joint line (row, col)."""
    rows, cols = image.shape[:2]
    whole = image[rows * 12 // 100 : rows * 86 // 100, cols * 20 // 100 : cols * 80 // 100]
    row, col, half = round(joint[0]), round(joint[1] + 6.0 / pixel_mm), round(31.0 / pixel_mm)
    near = image[row - half * 7 // 10 : row + half * 7 // 10, col - half : col + half]
    gap = np.full((8, COLS, 3), 255, np.uint8)
    return np.vstack(
        [make_panel(whole, COLS * 37 // 30, COLS, above), gap, make_panel(near, COLS * 7 // 10, COLS, below)]
    )


if __name__ == "__main__":
    run(Path(__file__).parent)
