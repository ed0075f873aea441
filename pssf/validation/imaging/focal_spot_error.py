"""Error of focal-spot models, compared with ray casting from many points of the focal spot."""

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...anatomy import build
from ...detector.detector_blur import blur_image_by_focal_spot
from ...geometry.scene import Scene
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...raycast import trace
from ...xray.primary_beam import compute_primary
from ...xray.resolved_technique import Technique, resolve_technique
from ...xray.sampled_primary import compute_sampled_primary
from ..raycasting.raycast_engines import Row

# Number of source points per side of the focal spot in the reference computation.
_REFERENCE_POINTS_PER_SIDE = 8


def measure_focal_spot_models(workers: int) -> list[Row]:
    """Measure error and run time of each focal-spot model for the primary signal around the joint.

    The image is the central 512 x 512 pixels of the protocol ``reference``.

    Parameters
    ----------
    workers : int
        Number of worker threads.

    Returns
    -------
    list of dict
        One row per focal-spot size and model. ``points`` is the number of source points along each edge of the square
        focal spot; 1 is a point source. ``"blur"`` is the blur model at the joint plane.
        ``rms``, ``p99`` and ``max`` are errors relative to ray casting from 64 source points.
    """
    scene, rows = build(Knee()).scene, list[Row]()
    for spot_mm in (0.6, 1.2):
        protocol = replace(load_protocol("reference"), rows=512, cols=512, focal_spot_mm=spot_mm)
        technique = resolve_technique(protocol)
        exact = compute_sampled_primary(scene, technique, "scanline", workers, _REFERENCE_POINTS_PER_SIDE).kev
        for points in ("blur", 1, 2, 3, 4, 5):
            start = perf_counter()
            if points == "blur":
                kev = compute_blurred_primary(scene, technique, workers)
            else:
                kev = compute_sampled_primary(scene, technique, "scanline", workers, int(points)).kev
            error = np.abs(kev / exact - 1)
            rows.append({
                "focal_spot_mm": spot_mm, "points": points,
                "seconds": round(perf_counter() - start, 3), "rms": float(f"{np.sqrt((error**2).mean()):.2g}"),
                "p99": float(f"{np.percentile(error, 99):.2g}"), "max": float(f"{error.max():.2g}"),
            })  # fmt: skip
    return rows


def compute_blurred_primary(scene: Scene, technique: Technique, workers: int) -> NDArray[np.float32]:
    """Compute the primary signal of a point source and blur it by the focal spot at the joint plane.

    Parameters
    ----------
    scene : Scene
        Scene whose primary signal is computed.
    technique : Technique
        Resolved technique, which includes protocol and view.
    workers : int
        Number of worker threads.

    Returns
    -------
    (rows, cols) float32 array
        Primary signal in keV per pixel.
    """
    paths = trace(scene, technique.protocol, engine="scanline", workers=workers).path_mm
    kev = compute_primary(paths, technique, workers).kev
    return blur_image_by_focal_spot(kev, technique.protocol.focal_spot_mm, technique.view, workers)
