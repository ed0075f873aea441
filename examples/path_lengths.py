"""Compute the path length of every ray in each tissue with both engines, and print the numbers of recomputed rays."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

# The brightest colour of each map represents this path length, in mm.
MAXIMUM_MM = {"cortical_bone": 25.0, "trabecular_bone": 70.0, "marrow": 25.0, "muscle": 130.0, "adipose": 100.0}


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the path lengths in five tissues as one PNG; the detector has `pixels` x `pixels` pixels."""
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    scene = pssf.build(pssf.Knee()).scene
    maps = {engine: pssf.trace(scene, protocol, engine=engine) for engine in ("embree", "scanline")}
    for engine, paths in maps.items():
        print(f"{engine}: {paths.audit}")
    panels, window = [], np.s_[pixels // 8 : pixels * 7 // 8, pixels // 5 : pixels * 4 // 5]
    for material, maximum_mm in MAXIMUM_MM.items():
        first, second = (paths.path_mm[material] for paths in maps.values())
        difference_mm = np.abs(first - second).max()
        print(f"{material}: longest path {first.max():.1f} mm, the engines differ by at most {difference_mm:.1g} mm")
        name = material.replace("_", " ")
        panels.append(
            make_panel(apply_heat_map(first[window], maximum_mm), 500, 400, f"{name}, 0 to {maximum_mm:g} mm")
        )
    panels.append(np.full_like(panels[0], 255))
    columns = [np.vstack(panels[first::3]) for first in range(3)]
    return [write_image_row(columns, out / "path_lengths.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
