"""Throughput: CPU time and disk space of radiographs of sampled knees with labels and masks."""

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from ...anatomy import build
from ...io.atomic_write import make_temporary_folder
from ...io.mask_files import save_masks
from ...io.radiograph_files import save
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.sampling.acquisition import sample_acquisition
from ...model.sampling.knee_sampling import sample_knee
from ...raycast import trace_sparse
from ...simulation import simulate
from ..raycasting.raycast_engines import Row, peak_memory_mb

# Numbers of rows and columns of the radiographs.
_MATRICES = (512, 2048)
# Number of KL grades of the sampled knees, 0 to 4.
_GRADES = 5
# Seed of the sampled knees and acquisitions.
_SEED = 59


def measure_throughput(knees: int) -> list[Row]:
    """Measure the CPU time of a new knee and of another acquisition of the same knee, with one thread.

    Parameters
    ----------
    knees : int
        Number of knees, sampled from the grade table ``population`` with KL grades 0 to 4 in turn.

    Returns
    -------
    list of dict
        One row per matrix and case: median CPU seconds to build the knee, to trace the rays, for labels and masks and
        for the other stages; images per minute and core; MB of disk space per image; and the peak memory of the process
        in MB. The protocol is ``fixed_flexion``.
    """
    rows: list[Row] = []
    for matrix in _MATRICES:
        protocol = load_protocol("fixed_flexion").resample(matrix)
        _measure_image(sample_knee(grade=0, rng=_SEED), protocol)  # A first image fills the caches.
        timed: dict[str, list[dict[str, float]]] = {"new knee": [], "another acquisition": []}
        for number in range(knees):
            rng = np.random.default_rng([_SEED, number])
            knee = sample_knee(grade=number % _GRADES, rng=rng)
            timed["new knee"].append(_measure_image(knee, protocol))
            timed["another acquisition"].append(_measure_image(knee, sample_acquisition(protocol, rng=rng)))
        for case, images in timed.items():
            median: dict[str, Any] = {name: float(np.median([one[name] for one in images])) for name in images[0]}
            rows.append({
                "matrix": matrix, "case": case, "knees": knees,
                **{name: round(value, 3) for name, value in median.items()},
                "images_per_minute": round(60 / median["cpu_seconds"], 1), "peak_mb": peak_memory_mb(),
            })  # fmt: skip
    return rows


def _measure_image(knee: Knee, protocol: Protocol) -> dict[str, float]:
    """Measure CPU seconds of each part of one image, and the disk space of image and masks in MB."""
    build_seconds, built = _measure_cpu(lambda: build(knee, protocol))
    aimed = built.aim_beam(protocol)
    ray_seconds, _ = _measure_cpu(lambda: trace_sparse(built.scene, aimed, workers=1))
    # Rays and labels are part of the simulation, so their separate times are subtracted from its time.
    simulation_seconds, radiograph = _measure_cpu(lambda: simulate(built, protocol, keep=("masks",), workers=1))
    plain_seconds, _ = _measure_cpu(lambda: simulate(built.scene, aimed, workers=1))
    with make_temporary_folder() as folder:
        image = save(radiograph, Path(folder) / "image.tif")
        masks = save_masks(radiograph, Path(folder) / "masks.tif")
        disk_mb = (image.stat().st_size + masks.stat().st_size) / 1e6
    return {
        "cpu_seconds": build_seconds + simulation_seconds,
        "build_seconds": build_seconds,
        "ray_seconds": ray_seconds,
        "label_seconds": max(0.0, simulation_seconds - plain_seconds),
        "other_seconds": max(0.0, plain_seconds - ray_seconds),
        "disk_mb": disk_mb,
    }


def _measure_cpu(call: Callable[[], Any]) -> tuple[float, Any]:
    """Call a function; return the CPU seconds of the process and the result."""
    start = process_time()
    result = call()
    return process_time() - start, result
