"""One person of the frozen data set: three doses and two tilts of the beam, as `pssf benchmark` takes everyone."""

import dataclasses
from pathlib import Path

import pssf
from pssf.data.knees.preset_table import load_presets
from pssf.io.pictures import make_panel, write_image_row

SIDE = 260


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the medial compartment at each dose and tilt as one PNG; `pixels` is the side of the detector."""
    taken = load_presets()["benchmark-1"]
    known = pssf.load_protocol(taken.protocols[0]).resample(pixels)
    knee = pssf.sample_knee(grade=3, rng=1, grade_table=taken.grade_table, side="right")
    built = pssf.build(knee, known)
    shown = []
    for tilt_deg in taken.tilts_deg:
        for dose in taken.doses:
            protocol = dataclasses.replace(
                known,
                mas=known.mas * dose,
                beam_angle_deg=known.beam_angle_deg + tilt_deg,
            )
            radiograph = pssf.simulate(built, protocol, rng=1)
            row, col = (round(place) for place in radiograph.truth.medial_joint_line_px)
            half = round(26.0 / known.pixel_mm)
            near = pssf.render_for_display(radiograph.pixels, processing="processed")[
                row - half : row + half, col - half : col + half
            ]
            shown.append(make_panel(near, SIDE, SIDE, f"{protocol.mas:g} mAs, {protocol.beam_angle_deg:g} deg"))
    return [write_image_row(shown, out / "doses_and_tilts.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
