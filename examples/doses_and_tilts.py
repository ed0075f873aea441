"""Simulate one subject at the three doses and two beam tilts of the data set that `pssf benchmark` makes."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.data.knees.preset_table import load_presets
from pssf.io.pictures import make_panel, write_image_row

SIDE = 400


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the medial compartment at each dose and tilt as one PNG; the detector has `pixels` x `pixels` pixels."""
    preset = load_presets()["benchmark-1"]
    nominal = pssf.load_protocol(preset.protocols[0]).resample(pixels)
    knee = pssf.sample_knee(grade=3, rng=1, grade_table=preset.grade_table, side="right")
    built = pssf.build(knee, nominal)
    columns = []
    for dose in preset.doses:
        panels = []
        for tilt_deg in preset.tilts_deg:
            protocol = dataclasses.replace(
                nominal,
                mas=nominal.mas * dose,
                beam_angle_deg=nominal.beam_angle_deg + tilt_deg,
            )
            radiograph = pssf.simulate(built, protocol, rng=1)
            row, col = (round(value) for value in radiograph.truth.medial_joint_line_px)
            half = round(26.0 / nominal.pixel_mm)
            compartment = pssf.render_for_display(radiograph.pixels, processing="processed")[
                row - half : row + half, col - half : col + half
            ]
            panels.append(make_panel(compartment, SIDE, SIDE, f"{protocol.mas:g} mAs, {protocol.beam_angle_deg:g} deg"))
        columns.append(np.vstack(panels))
    return [write_image_row(columns, out / "doses_and_tilts.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
