"""Effects of beam angle and leg rotation on radiographs of simulated knees, compared with published values.

Knees with grades 0 to 2 are sampled from the grade table ``population``, with one sampled acquisition per knee. The
mean plateau slope in ``grades/population.toml`` was chosen to reproduce the plateau margins of patients in fixed
flexion. No other parameter is fitted to the reference values.
"""

from dataclasses import replace

import numpy as np

from ...anatomy.labels.lateral_axial_labels import find_trochlea_px
from ...anatomy.meshing.rigid_pose import apply_transform
from ...anatomy.posture.attrition import build_outer_meshes
from ...anatomy.posture.knee_assembly import KneeAssembly, assemble_knee, load_jsw_protocol
from ...anatomy.posture.plateau_margins import align_beam_with_plateau, measure_inter_margin_mm
from ...anatomy.template.bone_builder import resolve_bone_parameters
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.analysis.reference_table import ReferenceValue, load_reference_tables
from ...data.anatomy.anatomy_tables import AnatomyTables, load_anatomy_tables
from ...data.knees.field_definitions import beam_angle_range_deg
from ...data.table_records import Pair
from ...geometry.mesh import Mesh
from ...geometry.view import project_points, resolve_view
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...model.sampling.acquisition import sample_acquisition
from ...model.sampling.knee_sampling import sample_knee
from ..raycasting.raycast_engines import Row

# Largest distance between anterior and posterior plateau margins that count as aligned, in mm (assumed, because the
# abstract of the source states no limit).
ALIGNED_MARGIN_MM = 1.5
# Caudal beam angle of the acquisition with a fixed beam angle, in degrees.
_FIXED_BEAM_DEG = 11.0
# Angle between the horizontal and the tangents that define the anterior and posterior plateau edges, in degrees.
_TOUCH_DEG = 30.0
# Minimum height of the tibia points that belong to the medial plateau, in mm in the frame of the tibia.
_ABOVE_MM = -30.0
# Inner limit of the medial plateau, as a fraction of half the tibial width from the midline.
_INNER = 0.36
# Outer limit of the medial plateau, as a fraction of half the tibial width from the midline.
_OUTER = 0.85
# Largest distance between aligned plateau margins in an alternative definition, in mm. The sources do not define all
# quantities exactly, so alternative definitions are compared with the same reference values.
_WIDER_MM = 2.5
# Factor that multiplies the beam-angle error of the Lyon-Schuss acquisition in an alternative definition of its
# inter-margin distance.
_MISSED_BY = 1.6
# Heights of the two shaft bands that define a projected shaft axis, in mm in the frame of the tibia.
_AXES_MM = (-120.0, -60.0)
# Half height of a shaft band, in mm.
_BAND_MM = 6.0
_ALTERNATIVE_DEFINITIONS = {
    "inter_margin_missed_by_more_mm": "inter_margin_lyon_schuss_mm",
    "aligned_within_more_percent": "aligned_at_11_deg_percent",
    "slope_per_rotation_outline_deg": "slope_per_rotation_deg",
    "slope_per_rotation_front_deg": "slope_per_rotation_deg",
}
# Leg rotations from the ideal lateral position, in degrees. A radiograph with a larger rotation would be repeated.
LEG_ROTATIONS_DEG = (-10.0, -5.0, 0.0, 5.0, 10.0)


def compare_views_with_literature(count: int, workers: int) -> list[Row]:
    """Compare view-dependent quantities of sampled knees with published values.

    Parameters
    ----------
    count : int
        Number of knees.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per quantity: mean, standard deviation, reference value or range, and ``off``. ``off`` is the difference
        between the mean and the reference value or the nearer end of the reference range.
    """
    knees = [sample_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="population") for k in range(count)]
    shared = {"tables": load_anatomy_tables(), "range_deg": beam_angle_range_deg()}
    measured = map_in_parallel(measure_knee_on_views, list(enumerate(knees)), shared=shared, workers=workers)
    values = {name: np.array([one[name] for one in measured]) for name in measured[0]}
    means = {name: (float(value.mean()), float(value.std(ddof=1))) for name, value in values.items()}
    means["beam_along_plateau_sd_deg"] = (means["beam_along_plateau_deg"][1], float("nan"))
    known = load_reference_tables().views
    rows = []
    for name in known:
        alike = [other for other, first in _ALTERNATIVE_DEFINITIONS.items() if first == name]
        rows += [_compare_quantity(one, known[name], means[one], count) for one in (name, *alike)]
    return rows


def _compare_quantity(name: str, reference: ReferenceValue, measured: tuple[float, float], count: int) -> Row:
    """Compare the measured mean and standard deviation of a quantity with a reference value or range."""
    mean, sd = measured
    low, high = reference.range or (reference.value, reference.value)
    assert low is not None
    assert high is not None
    return {
        "quantity": name,
        "value": round(mean, 3),
        "sd": "" if np.isnan(sd) else round(sd, 3),
        "knees": count,
        "reference": f"{low:g}" if low == high else f"{low:g} to {high:g}",
        "off": round(mean - float(np.clip(mean, low, high)), 3),
        "source": reference.source,
    }


def measure_knee_on_views(numbered_knee: tuple[int, Knee], tables: AnatomyTables, range_deg: Pair) -> dict[str, float]:
    """Measure view-dependent quantities of one knee.

    Distances and changes are absolute values, as in the reference publications.

    Parameters
    ----------
    numbered_knee : tuple of (int, Knee)
        Number of the knee, which is the seed of its acquisitions, and the knee.
    tables : AnatomyTables
        Anatomy tables.
    range_deg : tuple of float
        Smallest and largest beam angle, in degrees.

    Returns
    -------
    dict of str to float
        Quantities by name; the name suffix states the unit.
    """
    number, knee = numbered_knee
    rng = np.random.default_rng([number, 1])
    fixed, schuss = (
        sample_acquisition(load_protocol(name), rng=rng, side=knee.side) for name in ("fixed_flexion", "lyon_schuss")
    )
    assembly = assemble_knee(knee, resolve_bone_parameters(knee, tables), fixed.posture, load_jsw_protocol(knee))
    tibia = build_outer_meshes(assembly)[1]
    measured = {"inter_margin_fixed_flexion_mm": abs(measure_inter_margin_mm(assembly, tibia, resolve_view(fixed)))}
    assembly = assemble_knee(knee, resolve_bone_parameters(knee, tables), schuss.posture, load_jsw_protocol(knee))
    tibia = build_outer_meshes(assembly)[1]
    aimed = align_beam_with_plateau(assembly, tibia, schuss, range_deg)
    level = replace(schuss, beam_along="horizontal", beam_angle_deg=_FIXED_BEAM_DEG)
    missed = replace(schuss, beam_angle_deg=_MISSED_BY * schuss.beam_angle_deg)
    missed = align_beam_with_plateau(assembly, tibia, missed, range_deg)
    apart_mm = abs(measure_inter_margin_mm(assembly, tibia, resolve_view(level)))
    measured |= {
        "inter_margin_lyon_schuss_mm": abs(measure_inter_margin_mm(assembly, tibia, resolve_view(aimed))),
        "inter_margin_missed_by_more_mm": abs(measure_inter_margin_mm(assembly, tibia, resolve_view(missed))),
        "beam_along_plateau_deg": aimed.beam_angle_deg,
        "aligned_at_11_deg_percent": 100.0 * (apart_mm <= ALIGNED_MARGIN_MM),
        "aligned_within_more_percent": 100.0 * (apart_mm <= _WIDER_MM),
    }
    # For a lateral view, a radiographer rotates the leg until the condyles overlap, so the rotation of the knee is 0.
    turned = replace(knee, rotation_deg=0.0)
    return measured | _measure_slopes(turned, tables) | _measure_sulcus_angle(turned, tables)


def _measure_slopes(knee: Knee, tables: AnatomyTables) -> dict[str, float]:
    """Measure the medial plateau slope on a lateral view, and its change per degree of leg rotation."""
    protocol = load_protocol("lateral")
    assembly = assemble_knee(knee, resolve_bone_parameters(knee, tables), protocol.posture, load_jsw_protocol(knee))
    tibia, frame = build_outer_meshes(assembly)[1], assembly.pose.tibia_transform()
    own = Mesh((tibia.vertices - frame[:, 3]) @ frame[:, :3], tibia.faces)
    turned = [
        replace(assembly, pose=replace(assembly.pose, rotation_deg=assembly.pose.rotation_deg + turn))
        for turn in LEG_ROTATIONS_DEG
    ]
    slopes = {
        axis: [medial_plateau_slope_deg(one, own, axis) for one in turned] for axis in ("bone", "outline", "front")
    }
    # The sources report the absolute change.
    per_degree = {axis: abs(float(np.polyfit(LEG_ROTATIONS_DEG, read, 1)[0])) for axis, read in slopes.items()}
    return {
        "slope_on_lateral_deg": slopes["bone"][LEG_ROTATIONS_DEG.index(0.0)],
        "slope_per_rotation_deg": per_degree["bone"],
        "slope_per_rotation_outline_deg": per_degree["outline"],
        "slope_per_rotation_front_deg": per_degree["front"],
    }


def medial_plateau_slope_deg(assembly: KneeAssembly, tibia: Mesh, axis: str = "bone") -> float:
    """Measure the posterior slope of the medial plateau on a lateral view.

    The slope is measured on the line through the anterior and posterior plateau edge, which are found by tangents.

    Parameters
    ----------
    assembly : KneeAssembly
        Knee assembled in its posture.
    tibia : Mesh
        Outer surface of the tibia in the frame of the tibia, in mm.
    axis : {"bone", "outline", "front"}, default "bone"
        Shaft axis relative to which the slope is measured. ``"bone"`` is the anatomical axis. ``"outline"`` is the
        midline and ``"front"`` the anterior edge of the projected shaft.

    Returns
    -------
    float
        Posterior slope in degrees.
    """
    view, frame, half = (
        resolve_view(load_protocol("lateral")),
        assembly.pose.tibia_transform(),
        assembly.bone_parameters.half_ml_mm,
    )
    points = tibia.vertices
    medial = points[(points[:, 2] > _ABOVE_MM) & (points[:, 0] > _INNER * half) & (points[:, 0] < _OUTER * half)]

    def seen(places: Array) -> Array:
        return project_points(assembly.orient_points(apply_transform(places, frame)), view)

    up, back = _shaft_directions(seen(np.array([[0.0, 0.0, -100.0], [0.0, 0.0, -20.0]])), assembly.mirror[0])
    if axis != "bone":
        bands = (seen(points[np.abs(points[:, 2] - height_mm) < _BAND_MM]) for height_mm in _AXES_MM)
        up, back = _shaft_directions(
            np.array([_shaft_point_px(band, back, axis) for band in bands]), assembly.mirror[0]
        )
    height, across = seen(medial) @ up, seen(medial) @ back
    turn = np.deg2rad(_TOUCH_DEG)
    front, rear = ((height * np.cos(turn) + way * across * np.sin(turn)).argmax() for way in (-1.0, 1.0))
    return float(np.rad2deg(np.arctan2(height[front] - height[rear], across[rear] - across[front])))


def _shaft_point_px(outline: Array, backward: Array, axis: str) -> Array:
    """Return the anterior point or the middle (2,) of a projected shaft band (n, 2), in px.

    The middle is the midpoint of the anterior and the posterior point.
    """
    across = outline @ backward
    front, rear = outline[across.argmin()], outline[across.argmax()]
    return front if axis == "front" else (front + rear) / 2


def _shaft_directions(ends: Array, mirror: float) -> tuple[Array, Array]:
    """Return unit vectors in proximal direction along the shaft and in posterior direction on the radiograph.

    `ends` contains a lower and an upper point of the shaft, (2, 2), in px.
    """
    up = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return up, np.array([up[1], -up[0]]) * mirror


def _measure_sulcus_angle(knee: Knee, tables: AnatomyTables) -> dict[str, float]:
    """Measure the sulcus angle on a skyline view, in degrees."""
    protocol = load_protocol("skyline")
    assembly = assemble_knee(knee, resolve_bone_parameters(knee, tables), protocol.posture, load_jsw_protocol(knee))
    spots = find_trochlea_px(assembly, build_outer_meshes(assembly)[0], resolve_view(protocol))
    middle = np.array(spots["sulcus"])
    ways = [np.array(spots[f"trochlea_{side}"]) - middle for side in ("medial", "lateral")]
    cosine = ways[0] @ ways[1] / np.linalg.norm(ways[0]) / np.linalg.norm(ways[1])
    return {"sulcus_angle_deg": float(np.rad2deg(np.arccos(cosine)))}
