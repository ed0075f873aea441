"""One person of the frozen data set: three doses and two tilts of the beam, as `pssf benchmark` takes everyone."""

import dataclasses
from pathlib import Path

import pssf
from pssf.data.presets import presets
from pssf.io.pictures import panel, side_by_side

SIDE = 260


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the medial compartment at each dose and tilt as one PNG; `pixels` is the side of the detector."""
    taken = presets()["benchmark-1"]
    known = pssf.load_protocol(taken.protocols[0]).resampled(pixels)
    knee = pssf.draw_knee(grade=3, rng=1, grade_table=taken.grade_table, side="right")
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
            near = pssf.present(radiograph.pixels, look="processed")[row - half : row + half, col - half : col + half]
            shown.append(panel(near, SIDE, SIDE, f"{protocol.mas:g} mAs, {protocol.beam_angle_deg:g} deg"))
    return [side_by_side(shown, out / "doses_and_tilts.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
