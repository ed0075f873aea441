"""Sensitivity of texture measures to the structure of the trabecular bone, on one knee.

The surfaces of the knee stay the same. The struts, their mineral and the acquisition vary according to a Sobol design.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs
from scipy import stats

from ...anatomy import BuiltKnee, build
from ...anatomy.trabeculae.strut_lattice import make_strut_lattice
from ...anatomy.trabeculae.trabecular_density import BONES, Trabeculae, build_trabeculae
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.anatomy.trabecular_table import StrutLattice, TrabecularBone, load_trabecular_bone
from ...geometry.scene import Scene
from ...model.knee import Knee
from ...model.protocol import Protocol
from ...study.design.sensitivity_plan import sample_unit_design
from ...study.statistics.analyses.sensitivity_analysis import analyse_sobol_design
from ..raycasting.raycast_engines import Row
from .texture_conditions import load_region_protocol, measure_radiograph, simulate_one

_SEED = 68
# Number of distinct texture seeds of the design.
_SEEDS = 2**32


class _Factor(NamedTuple):
    """Quantity that the design varies between two bounds, evenly or evenly in its logarithm."""

    group: str
    low: float
    high: float
    logarithmic: bool = False


# All bounds are assumed. `size` magnifies the lattice, struts and spaces alike. With a higher
# `threshold`, struts are fewer and farther apart. `anisotropy` is the power of vertical struts, relative to 0.75 for
# isotropic struts. `contrast` scales the strut contrast. `density` and `plate` are fields of the knee, but `plate`
# changes only the trabecular bone. The mAs are relative, and kV and beam angle are differences.
_FACTORS = {
    "size": _Factor("strut size", 0.8, 1.25, logarithmic=True),
    "threshold": _Factor("strut number", 1.0, 1.6),
    "anisotropy": _Factor("anisotropy", 2.5, 20.0, logarithmic=True),
    "contrast": _Factor("strut contrast", 0.6, 1.0),
    "density": _Factor("mineral", 0.7, 1.3),
    "plate": _Factor("sclerosis", 1.0, 1.8),
    "mas": _Factor("acquisition", 0.5, 2.0, logarithmic=True),
    "tube_kv": _Factor("acquisition", -5.0, 5.0),
    "beam_angle_deg": _Factor("acquisition", -3.0, 3.0),
    "chance": _Factor("chance", 0.0, 1.0),
}
# Properties of the bone with which the measures are correlated.
BONE_PROPERTIES = ("spacing_mm", "thickness_mm", "anisotropy", "contrast", "density", "plate")


def measure_texture_structure(samples: int, workers: int = 1) -> list[Row]:
    """Measure which properties of the trabecular bone explain the variance of each texture measure.

    Parameters
    ----------
    samples : int
        Number of samples N of the Sobol design, at least 32; the design has 10 N points.
    workers : int, default 1
        Number of processes.

    Returns
    -------
    list of dict
        One row per feature: total Sobol index of each group, and Spearman correlation over all points with each
        property of `BONE_PROPERTIES`. Spacing and thickness are mean chord lengths of marrow and bone along x in the
        lattice.
    """
    points = _scale_points(sample_unit_design([one.group for one in _FACTORS.values()], samples, _SEED))
    jobs = [dict(zip(_FACTORS, point, strict=True)) for point in points.tolist()]
    measured = map_in_parallel(_measure_point, jobs, shared={"table": load_trabecular_bone()}, workers=workers)
    names = list(measured[0][0])
    values = np.array([[of_features[name] for name in names] for of_features, _ in measured])
    bone = {name: np.array([of_bone[name] for _, of_bone in measured]) for name in BONE_PROPERTIES}
    rows: list[Row] = []
    for feature, part in analyse_sobol_design(_make_problem(), values, names, _SEED).groupby("feature", sort=False):
        of_feature = values[:, names.index(str(feature))]
        shares = {f"total, {row['group']}": float(row["total"]) for row in part.to_dict("records")}
        widest = float((part["total_high"] - part["total_low"]).max() / 2)
        correlations = {f"r, {name}": float(stats.spearmanr(of_feature, bone[name]).statistic) for name in bone}
        label = {"feature": feature, "samples": int(part["samples"].iloc[0])}
        rows.append({**label, **shares, "widest_interval": widest, **correlations})
    return rows


def _make_problem() -> dict[str, Any]:
    """Make the problem definition of SALib."""
    return {
        "num_vars": len(_FACTORS),
        "names": list(_FACTORS),
        "bounds": [[one.low, one.high] for one in _FACTORS.values()],
        "groups": [one.group for one in _FACTORS.values()],
    }


def _scale_points(unit: Array) -> Array:
    """Map points (points, factors) between 0 and 1 to the bounds of the factors."""
    columns = []
    for column, one in zip(unit.T, _FACTORS.values(), strict=True):
        low, high = np.log([one.low, one.high]) if one.logarithmic else (one.low, one.high)
        values = low + column * (high - low)
        columns.append(np.exp(values) if one.logarithmic else values)
    return np.stack(columns, axis=1)


def _measure_point(point: Mapping[str, float], *, table: TrabecularBone) -> tuple[dict[str, float], dict[str, float]]:
    """Measure the texture at one point of the design; return the features and the properties of the bone."""
    built, protocol = _build_knee()
    made = {
        id(density): _alter_trabeculae(built, bone, density, point, table)
        for bone, density in _find_densities(built.scene).items()
    }
    surfaces = [
        replace(
            one,
            inside_density=made.get(id(one.inside_density), one.inside_density),
            outside_density=made.get(id(one.outside_density), one.outside_density),
        )
        for one in built.scene.surfaces
    ]
    changed = replace(
        protocol,
        mas=protocol.mas * point["mas"],
        tube_kv=protocol.tube_kv + point["tube_kv"],
        beam_angle_deg=protocol.beam_angle_deg + point["beam_angle_deg"],
    )
    scene = Scene(surfaces, built.scene.ambient, built.scene.size_mm)
    features = measure_radiograph(simulate_one(replace(built, scene=scene), changed, _find_seed(point)))
    return features, {**point, **_measure_struts(next(iter(made.values())))}


@lru_cache(maxsize=1)
def _build_knee() -> tuple[BuiltKnee, Protocol]:
    """Build the knee whose trabecular bone varies."""
    protocol = load_region_protocol()
    return build(Knee(), protocol), protocol


def _find_seed(point: Mapping[str, float]) -> int:
    """Find the seed of struts and noise of a point of the design."""
    return int(point["chance"] * (_SEEDS - 1))


def _find_densities(scene: Scene) -> dict[str, Trabeculae]:
    """Find the trabecular density of each bone of a scene."""
    return {
        bone: one.inside_density
        for one in scene.surfaces
        for bone in BONES
        if one.name.startswith(bone) and isinstance(one.inside_density, Trabeculae)
    }


def _alter_trabeculae(
    built: BuiltKnee, bone: str, density: Trabeculae, point: Mapping[str, float], table: TrabecularBone
) -> Trabeculae:
    """Make the trabecular density of a bone for one point of the design, at the pose of the given density."""
    knee = built.knee
    made = build_trabeculae(
        bone,
        table,
        seed=_find_seed(point),
        scale=built.assembly.bone_parameters.scale,
        frame=np.eye(3, 4),
        mirror=(1.0, 1.0, 1.0),
        sclerosis=point["plate"],
        age_years=knee.age_years,
        sex=knee.sex,
        density=point["density"],
        sclerotic_side=knee.sclerotic_side,
    )
    parameters = made.density_parameters
    contrast = {name: getattr(parameters, name) * point["contrast"] for name in ("gain", "gain_shaft")}
    return replace(
        made,
        density_parameters=parameters._replace(**contrast),
        lattice_table=_magnify_lattice(
            structs.replace(table.lattice, threshold_sd=point["threshold"], vertical_power=point["anisotropy"]),
            point["size"],
        ),
        knee_to_bone=density.knee_to_bone,
    )


def _magnify_lattice(lattice: StrutLattice, factor: float) -> StrutLattice:
    """Magnify a lattice: the same voxels, each of them larger."""
    x, z, y = (length * factor for length in lattice.voxel_mm)
    frequencies = {
        name: getattr(lattice, name) / factor for name in ("low_per_mm", "high_per_mm", "length_per_mm", "patch_per_mm")
    }
    return structs.replace(lattice, voxel_mm=(x, z, y), **frequencies)


def _measure_struts(density: Trabeculae) -> dict[str, float]:
    """Measure the mean chord length of marrow (``spacing_mm``) and of bone (``thickness_mm``) along x."""
    block, _ = make_strut_lattice(density.seed, density.lattice_table)
    bone = block > 127
    # Each strut that a line crosses has one entry; a line of n voxels with bone fraction f has n f voxels in struts.
    entries = np.count_nonzero(bone[1:] & ~bone[:-1])
    inside = np.count_nonzero(bone[:-1])
    step = density.lattice_table.voxel_mm[0]
    total = bone[:-1].size
    return {"thickness_mm": step * inside / entries, "spacing_mm": step * (total - inside) / entries}
