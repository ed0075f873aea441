"""Build success of random knees, sampled in equal numbers from the grade tables and from wide adult ranges."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from ...anatomy import build
from ...anatomy.posture.knee_assembly import load_jsw_protocol
from ...core.checks import InputError
from ...core.processes.parallel_map import map_in_parallel
from ...data.anatomy.shape_table import load_shape_model
from ...data.knees.grade_tables import load_grade_table
from ...geometry.scene import Scene
from ...model.knee import OSTEOPHYTE_SITES, Knee, Osteophyte
from ...model.protocol import load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...raycast import trace
from ..raycasting.raycast_engines import Row

# Uniform ranges of wide-range knees: the widest ranges that occur in adults and that the grades allow.
_UNIFORM_RANGES = {
    "stature_mm": (1450.0, 2000.0),
    "jsw_medial_mm": (2.5, 5.5),
    "jsw_lateral_mm": (3.5, 5.5),
    "subchondral_plate": (1.0, 1.6),
    "varus_deg": (-5.0, 5.0),
    "flexion_deg": (0.0, 15.0),
    "rotation_deg": (-10.0, 10.0),
    "bone_scale": (0.9, 1.1),
    "cortex_scale": (0.7, 1.3),
    "bone_density": (0.5, 1.5),
    "tibial_slope_deg": (0.0, 12.0),
    "limb_ap_mm": (90.0, 160.0),
    "fat_mm": (3.0, 25.0),
    "skin_folds": (0.0, 0.85),
    "lean_deg": (-12.0, 12.0),
    "fibular_tip_mm": (5.0, 26.0),
    "insall_salvati": (0.7, 1.6),
    "patellar_shift_mm": (-5.0, 10.0),
    "patellar_tilt_deg": (-8.0, 14.0),
    "fabella_mm": (4.0, 14.0),
}
# Grade tables from which half of the knees are sampled, with cyclically assigned grades.
_GRADE_TABLES = ("paper", "population")
# Absolute score of each shape mode in a wide-range knee, in standard deviations; the sign is random.
_SHAPE_SD = 3.0


def measure_knee_builds(count: int, workers: int, progress: Callable[[str], None] = lambda line: None) -> list[Row]:
    """Build random knees; report successes, failures, label errors and self-intersecting surfaces.

    ``build`` raises InputError unless solids are valid, shells are nested and bones do not touch. Knees with odd
    numbers are sampled from the grade tables, and knees with even numbers by :func:`sample_wide_range_knee`.

    Parameters
    ----------
    count : int
        Number of knees.
    workers : int
        Number of worker processes.
    progress : callable
        Function called with a line of text for each failure and after each tenth of the knees.

    Returns
    -------
    list of dict
        One row. ``knees``, ``built`` and ``failed`` are counts; ``first_error`` is the first error message.
        ``jsw_error_mm`` is the largest error of joint space width, which occurs in knee ``jsw_error_knee``.
        ``min_path_mm`` is the smallest path length of a ray in a material, which occurs in knee ``min_path_knee``. It
        is negative if a surface intersects itself, else 0. ``min_triangles``, ``max_triangles`` and
        ``median_seconds`` are numbers of triangles and build time of the built knees.

    Notes
    -----
    Rays are traced under the protocol that defines joint space width, and under ``geometry_shift``.
    """
    drawn = tuple((table, grade) for table in _GRADE_TABLES for grade in load_grade_table(table).grades)
    attempts = map_in_parallel(
        _build_random_knee,
        list(range(count)),
        shared={"grade_choices": drawn, "modes": len(load_shape_model().modes)},
        workers=workers,
        on_result=_make_progress_callback(count, progress),
    )
    errors = [f"knee {number}: {one['error']}" for number, one in enumerate(attempts) if one["error"]]
    built = {number: one for number, one in enumerate(attempts) if not one["error"]}
    triangles = [one["triangles"] for one in built.values()]
    error, off = max((one["jsw_error_mm"], number) for number, one in built.items())
    least, where = min((one["min_path_mm"], number) for number, one in built.items())
    return [{
        "knees": count, "built": len(built), "failed": len(errors), "first_error": (errors or [""])[0],
        "jsw_error_mm": float(f"{error:.2g}"), "jsw_error_knee": off,
        "min_path_mm": float(f"{least:.2g}"), "min_path_knee": where if least < 0 else "",
        "min_triangles": min(triangles), "max_triangles": max(triangles),
        "median_seconds": round(float(np.median([one["seconds"] for one in built.values()])), 2),
    }]  # fmt: skip


def _make_progress_callback(count: int, progress: Callable[[str], None]) -> Callable[[int, Row], None]:
    """Make a callback that reports each failed knee and the progress after each tenth of the knees."""
    done = failed = 0

    def arrived(number: int, one: Row) -> None:
        nonlocal done, failed
        done += 1
        if one["error"]:
            failed += 1
            progress(f"builds: knee {number} could not be built: {one['error']}")
        if done * 10 // count > (done - 1) * 10 // count:
            progress(f"builds: {done} of {count} knees, {failed} could not be built")

    return arrived


def _build_random_knee(number: int, grade_choices: tuple[tuple[str, int], ...], modes: int) -> Row:
    """Sample knee `number`, build it and measure its errors; return the error message if it cannot be built."""
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(1,)))
    table, grade = grade_choices[number // 2 % len(grade_choices)]
    knee = sample_knee(grade=grade, rng=rng, grade_table=table) if number % 2 else sample_wide_range_knee(rng, modes)
    protocol = load_jsw_protocol(knee)
    start = perf_counter()
    try:
        built = build(knee, protocol)
    except InputError as error:
        return {"error": str(error)}
    seconds = perf_counter() - start
    spaces = built.measure_jsw_mm(protocol)
    return {
        "error": "",
        "jsw_error_mm": max(abs(spaces[0] - knee.jsw_medial_mm), abs(spaces[1] - knee.jsw_lateral_mm)),
        "min_path_mm": min(_least_path_mm(built.scene, name) for name in (protocol.name, "geometry_shift")),
        "triangles": sum(len(surface.mesh.faces) for surface in built.scene.surfaces),
        "seconds": seconds,
    }


def _least_path_mm(scene: Scene, protocol: str) -> float:
    """Return the smallest path length of a ray in a material, over all rays and materials, in mm."""
    paths = trace(scene, load_protocol(protocol), engine="scanline", precision="float64", texture=False, workers=1)
    return min(float(lengths.min()) for lengths in paths.path_mm.values())


def sample_wide_range_knee(rng: np.random.Generator, modes: int) -> Knee:
    """Sample a knee uniformly from wide adult ranges, with each shape mode at -3 or +3 standard deviations.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of random numbers.
    modes : int
        Number of shape modes.

    Returns
    -------
    Knee
        Sampled knee.
    """
    sites = rng.permutation(OSTEOPHYTE_SITES)[: rng.integers(0, len(OSTEOPHYTE_SITES) + 1)]
    fields: dict[str, Any] = {name: float(rng.uniform(*bounds)) for name, bounds in _UNIFORM_RANGES.items()}
    osteophytes = tuple(Osteophyte(site=str(site), size_mm=float(rng.uniform(0.2, 3.0))) for site in sites)
    side, sex = rng.choice(["left", "right"]), rng.choice(["male", "female"])
    shape = tuple(_SHAPE_SD * float(sign) for sign in rng.choice([-1.0, 1.0], modes))
    return Knee(side=str(side), sex=str(sex), osteophytes=osteophytes, shape=shape, **fields)
