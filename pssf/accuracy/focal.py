"""Focal spot: blur of the whole image against rays from points of the spot."""

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..anatomy import build
from ..detector.blur import focal_spot_blur
from ..geometry.scene import Scene
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..raycast import trace
from ..stages import sampled_primary
from ..xray.primary import primary_of
from ..xray.technique import Technique, technique_of
from .engines import Row

# What is taken as exact: rays from so many points a side.
_EXACT = 8


def focal_rows(workers: int) -> list[Row]:
    """One row a spot and model: seconds and error of the primary signal of the joint, 512 x 512 of `reference`.

    points  a side of the spot that rays come from; 1 is a point without blur, "blur" the blur at the joint
    rms, p99, max  relative error against rays from 64 points
    """
    scene, rows = build(Knee()).scene, list[Row]()
    for spot_mm in (0.6, 1.2):
        protocol = replace(load_protocol("reference"), rows=512, cols=512, focal_spot_mm=spot_mm)
        technique = technique_of(protocol)
        exact = sampled_primary(scene, technique, "scanline", workers, _EXACT).kev
        for points in ("blur", 1, 2, 3, 4, 5):
            start = perf_counter()
            if points == "blur":
                kev = blurred_primary(scene, technique, workers)
            else:
                kev = sampled_primary(scene, technique, "scanline", workers, int(points)).kev
            error = np.abs(kev / exact - 1)
            rows.append({
                "focal_spot_mm": spot_mm, "points": points,
                "seconds": round(perf_counter() - start, 3), "rms": float(f"{np.sqrt((error**2).mean()):.2g}"),
                "p99": float(f"{np.percentile(error, 99):.2g}"), "max": float(f"{error.max():.2g}"),
            })  # fmt: skip
    return rows


def blurred_primary(scene: Scene, technique: Technique, workers: int) -> NDArray[np.float32]:
    """(rows, cols)  keV a pixel, of one point, with the blur of the whole spot at the joint"""
    paths = trace(scene, technique.protocol, engine="scanline", workers=workers).path_mm
    kev = primary_of(paths, technique, workers).kev
    return focal_spot_blur(kev, technique.protocol.focal_spot_mm, technique.view, workers)
