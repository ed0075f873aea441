"""Draw the sixteen contour landmarks of a radiograph with their names."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import pssf
from pssf.core.label_names import CONTOUR_LANDMARKS, FEMORAL_LANDMARKS
from pssf.io.pictures import write_image_row

FEMUR, TIBIA = (90, 200, 250), (255, 200, 60)
# Size of the picture, in pixels, and size of the field that it shows, in plateau widths.
ROWS, COLS, LEGEND_ROWS = 560, 1120, 220
ACROSS = 1.25


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the joint with numbered landmarks and their names as PNG; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.sample_knee(grade=1, rng=8, side="right", sex="female")
    protocol = pssf.load_protocol("fixed_flexion").resample(pixels)
    radiograph = pssf.simulate(knee, protocol, rng=2, keep=("masks",))
    image = pssf.render_for_display(radiograph.pixels, processing="processed")
    places = {name: np.array(radiograph.truth.landmarks_px[name]) for name in CONTOUR_LANDMARKS}
    edges = places["tibia_lateral_edge"], places["tibia_medial_edge"]
    width, (row, col) = np.hypot(*(edges[1] - edges[0])), (edges[0] + edges[1]) / 2
    zoom = COLS / (ACROSS * width)
    top, left = row - 0.6 * ROWS / zoom, col - 0.5 * COLS / zoom
    box = (left, top, left + COLS / zoom, top + ROWS / zoom)
    joint = Image.fromarray(image).resize((COLS, ROWS), Image.Resampling.BICUBIC, box).convert("RGB")
    picture = Image.new("RGB", (COLS, ROWS + LEGEND_ROWS), "black")
    picture.paste(joint)
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(17)
    for number, (name, place) in enumerate(places.items(), 1):
        colour = FEMUR if name in FEMORAL_LANDMARKS else TIBIA
        y, x = ((place - (top, left)) * zoom).tolist()
        pen.ellipse((x - 5, y - 5, x + 5, y + 5), fill=colour, outline="black")
        # Numbers of the femur stand above and numbers of the tibia below the joint space.
        pen.text(
            (x, y + (-22 if colour == FEMUR else 22)),
            str(number),
            colour,
            font,
            anchor="mm",
            stroke_width=3,
            stroke_fill="black",
        )
        column, line = divmod(number - 1, 6)
        pen.text((30 + 370 * column, ROWS + 22 + 32 * line), f"{number}  {name}", colour, font)
    return [write_image_row([np.asarray(picture)], out / "contour_landmarks.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
