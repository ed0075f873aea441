"""Throughput: CPU time and disk space of radiographs of sampled knees with labels and masks."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from ...anatomy import build
from ...core.processes.child_processes import start_without_working_folder
from ...core.processes.parallel_map import map_in_parallel
from ...core.processes.worker_processes import limit_to_one_thread, retain_freed_memory
from ...io.atomic_write import make_temporary_folder
from ...io.mask_files import save_masks
from ...io.radiograph_files import save
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.radiograph import Radiograph
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
# Ray casting engine of data sets and cohorts.
_ENGINE = "scanline"


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
        # Images are made in a new process with the settings of a worker, as in a data set.
        with start_without_working_folder(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            rows += pool.submit(_measure_matrix, matrix, knees).result()
    return rows


def measure_worker_scaling(knees: int) -> list[Row]:
    """Measure how many times as many images two workers make as one worker.

    Parameters
    ----------
    knees : int
        Number of new knees, sampled as for `measure_throughput`. Their radiographs have 512 x 512 pixels.

    Returns
    -------
    list of dict
        One row per number of workers: run time in s, images per minute, and the ratio to one worker.
    """
    drawn = [sample_numbered_knee(number)[0] for number in range(knees)]
    protocol = load_protocol("fixed_flexion").resample(_MATRICES[0])
    shares = {1: [drawn, []], 2: [drawn[::2], drawn[1::2]]}
    # The first run starts both workers and fills their caches.
    map_in_parallel(_make_images, [drawn[:1], drawn[1:2]], shared={"protocol": protocol}, workers=2)
    seconds = {}
    for workers, parts in shares.items():
        start = perf_counter()
        map_in_parallel(_make_images, parts, shared={"protocol": protocol}, workers=2)
        seconds[workers] = perf_counter() - start
    return [
        {
            "workers": workers, "knees": knees, "seconds": round(taken, 2),
            "images_per_minute": round(60 * knees / taken, 1), "ratio": round(seconds[1] / taken, 2),
        }
        for workers, taken in seconds.items()
    ]  # fmt: skip


def _make_images(knees: list[Knee], protocol: Protocol) -> None:
    """Make radiographs of knees with labels and masks, without saving them."""
    for knee in knees:
        _simulate(knee, protocol, ("masks",))


def _simulate(subject: Any, protocol: Protocol, keep: tuple[str, ...] = ()) -> Radiograph:
    """Simulate a radiograph with one thread and the ray casting engine of data sets."""
    return simulate(subject, protocol, keep=keep, engine=_ENGINE, workers=1)


def sample_numbered_knee(number: int) -> tuple[Knee, np.random.Generator]:
    """Sample a knee for the measurement of images; consecutive knees have KL grades 0 to 4 in turn.

    Parameters
    ----------
    number : int
        Number of the knee, from 0.

    Returns
    -------
    knee : Knee
        Knee from the grade table ``population``.
    rng : numpy.random.Generator
        Generator for acquisitions of the knee.
    """
    rng = np.random.default_rng([_SEED, number])
    return sample_knee(grade=number % _GRADES, rng=rng), rng


def _measure_matrix(matrix: int, knees: int) -> list[Row]:
    """Measure radiographs with one number of pixels, in a process with the settings of a worker."""
    retain_freed_memory()
    protocol = load_protocol("fixed_flexion").resample(matrix)
    timed: dict[str, list[dict[str, float]]] = {"new knee": [], "another acquisition": []}
    with limit_to_one_thread():
        _measure_image(sample_knee(grade=0, rng=_SEED), protocol)  # A first image fills the caches.
        for number in range(knees):
            knee, rng = sample_numbered_knee(number)
            timed["new knee"].append(_measure_image(knee, protocol))
            timed["another acquisition"].append(_measure_image(knee, sample_acquisition(protocol, rng=rng)))
    rows: list[Row] = []
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
    ray_seconds, _ = _measure_cpu(lambda: trace_sparse(built.scene, aimed, engine=_ENGINE, workers=1))
    # Rays and labels are part of the simulation, so their separate times are subtracted from its time.
    simulation_seconds, radiograph = _measure_cpu(lambda: _simulate(built, protocol, ("masks",)))
    plain_seconds, _ = _measure_cpu(lambda: _simulate(built.scene, aimed))
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
