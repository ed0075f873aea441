"""What the rays see: path length in each tissue, in millimetres, and the audit of the rays."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

SHOWN = {"cortical_bone": 25.0, "trabecular_bone": 70.0, "marrow": 25.0, "muscle": 130.0, "adipose": 60.0}


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the path lengths in five tissues as one PNG; `pixels` is the side of the detector."""
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    scene = pssf.build(pssf.Knee()).scene
    maps = {engine: pssf.trace(scene, protocol, engine=engine) for engine in ("embree", "scanline")}
    for engine, paths in maps.items():
        print(engine, paths.audit)
    shown, part = [], np.s_[pixels // 8 : pixels * 7 // 8, pixels // 5 : pixels * 4 // 5]
    for material, most_mm in SHOWN.items():
        one, two = (paths.path_mm[material] for paths in maps.values())
        apart_mm = np.abs(one - two).max()
        print(f"{material}: longest path {one.max():.1f} mm, engines differ by {apart_mm:.1g} mm at most")
        name = material.replace("_", " ")
        shown.append(make_panel(apply_heat_map(one[part], most_mm), 400, 320, f"{name}, 0 to {most_mm:g} mm"))
    return [write_image_row(shown, out / "path_lengths.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
