"""What the rays see: path length in bone, in millimetres, and the audit of the rays."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import side_by_side


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the path lengths in cortical and in trabecular bone as one PNG; `pixels` is the side of the detector."""
    reference = pssf.load_protocol("reference")
    protocol = dataclasses.replace(reference, rows=pixels, cols=pixels, pixel_mm=307.2 / pixels)
    scene = pssf.build(pssf.Knee())
    maps = {engine: pssf.trace(scene, protocol, engine=engine) for engine in ("embree", "scanline")}
    for engine, paths in maps.items():
        print(engine, paths.audit)
    shown = []
    for material, most_mm in (("cortical_bone", 25.0), ("trabecular_bone", 60.0)):
        one, two = (paths.path_mm[material] for paths in maps.values())
        print(
            f"{material}: longest path {one.max():.1f} mm, engines differ by {np.abs(one - two).max():.1g} mm at most"
        )
        shown.append(np.clip(255 * one / most_mm, 0, 255).astype(np.uint8))
    return [side_by_side(shown, out / "path_lengths.png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
