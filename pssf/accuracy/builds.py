"""Random knees built, half of them drawn as cohorts' are, by every table, half from all over the ranges of an adult."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from ..anatomy import build
from ..anatomy.joint import defining_protocol
from ..core.checks import InputError
from ..core.parallel import ordered_map
from ..data.grade_tables import grade_table
from ..data.shapes import shape_table
from ..geometry.scene import Scene
from ..model.draw import draw_knee
from ..model.knee import SITES, Knee, Osteophyte
from ..model.protocol import load_protocol
from ..raycast import trace
from .engines import Row

# Of the second half: uniform in these, the widest of what a grade may have and of what is found in adults.
_RANGES = {
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
# Of the first half: tables of grades, of which each grade has its turn.
_TABLES = ("paper", "population")
# Standard deviations at which every mode of the shape stands, to either side.
_SHAPE_SD = 3.0


def build_rows(count: int, workers: int, say: Callable[[str], None] = lambda line: None) -> list[Row]:
    """How many were built and how many refused, with the first refusal; whose joint space is farthest off, triangles.

    A built knee has valid solids, nested shells and bones that keep clear of each other: `build` refuses others. The
    least path in any material along any ray (as joint spaces are defined, and of geometry shift), and the knee that has
    it, is 0 unless a surface folds over itself.
    say  is told of each refusal when it comes, and how far it is at each tenth
    """
    drawn = tuple((table, grade) for table in _TABLES for grade in grade_table(table).grades)
    attempts = ordered_map(
        _built,
        list(range(count)),
        shared={"drawn": drawn, "modes": len(shape_table().modes)},
        workers=workers,
        arrived=_counted(count, say),
    )
    refused = [f"knee {number}: {one['refused']}" for number, one in enumerate(attempts) if one["refused"]]
    built = {number: one for number, one in enumerate(attempts) if not one["refused"]}
    triangles = [one["triangles"] for one in built.values()]
    error, off = max((one["jsw_error_mm"], number) for number, one in built.items())
    least, where = min((one["least_path_mm"], number) for number, one in built.items())
    return [{
        "knees": count, "built": len(built), "refused": len(refused), "first_refusal": (refused or [""])[0],
        "jsw_error_mm": float(f"{error:.2g}"), "jsw_error_knee": off,
        "least_path_mm": float(f"{least:.2g}"), "least_path_knee": where if least < 0 else "",
        "least_triangles": min(triangles), "most_triangles": max(triangles),
        "median_seconds": round(float(np.median([one["seconds"] for one in built.values()])), 2),
    }]  # fmt: skip


def _counted(count: int, say: Callable[[str], None]) -> Callable[[int, Row], None]:
    """What is told number and row of each knee, and says the refusals and each tenth of `count`."""
    done = refused = 0

    def arrived(number: int, one: Row) -> None:
        nonlocal done, refused
        done += 1
        if one["refused"]:
            refused += 1
            say(f"builds: knee {number} refused: {one['refused']}")
        if done * 10 // count > (done - 1) * 10 // count:
            say(f"builds: {done} of {count}, {refused} refused")

    return arrived


def _built(number: int, drawn: tuple[tuple[str, int], ...], modes: int) -> Row:
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(1,)))
    table, grade = drawn[number // 2 % len(drawn)]
    knee = draw_knee(grade=grade, rng=rng, grade_table=table) if number % 2 else wide_knee(rng, modes)
    protocol = defining_protocol(knee)
    start = perf_counter()
    try:
        built = build(knee, protocol)
    except InputError as error:
        return {"refused": str(error)}
    seconds = perf_counter() - start
    spaces = built.measured_jsw_mm(protocol)
    return {
        "refused": "",
        "jsw_error_mm": max(abs(spaces[0] - knee.jsw_medial_mm), abs(spaces[1] - knee.jsw_lateral_mm)),
        "least_path_mm": min(_least_path_mm(built.scene, name) for name in (protocol.name, "geometry_shift")),
        "triangles": sum(len(surface.mesh.faces) for surface in built.scene.surfaces),
        "seconds": seconds,
    }


def _least_path_mm(scene: Scene, protocol: str) -> float:
    paths = trace(scene, load_protocol(protocol), engine="scanline", precision="float64", texture=False, workers=1)
    return min(float(lengths.min()) for lengths in paths.path_mm.values())


def wide_knee(rng: np.random.Generator, modes: int) -> Knee:
    """A knee from all over the ranges of an adult, with so many modes of its shape at an end."""
    sites = rng.permutation(SITES)[: rng.integers(0, len(SITES) + 1)]
    fields: dict[str, Any] = {name: float(rng.uniform(*bounds)) for name, bounds in _RANGES.items()}
    osteophytes = tuple(Osteophyte(site=str(site), size_mm=float(rng.uniform(0.2, 3.0))) for site in sites)
    side, sex = rng.choice(["left", "right"]), rng.choice(["male", "female"])
    shape = tuple(_SHAPE_SD * float(sign) for sign in rng.choice([-1.0, 1.0], modes))
    return Knee(side=str(side), sex=str(sex), osteophytes=osteophytes, shape=shape, **fields)
