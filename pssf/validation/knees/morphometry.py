"""Comparison of bone sizes of simulated knees with published sizes, and errors of the knee labels."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import trimesh

from ...anatomy import build
from ...anatomy.meshing.solids import extract_mesh
from ...anatomy.posture.knee_assembly import KneeAssembly
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.analysis.reference_table import ReferenceSize, load_reference_tables
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ..raycasting.raycast_engines import Row

Sizes = dict[str, float]


def compare_sizes_with_literature(count: int, workers: int) -> list[Row]:
    """Compare bone sizes of sampled knees with published sizes, and measure the errors of the knee labels.

    Parameters
    ----------
    count : int
        Number of knees; successive knees have grades 0, 1, 2, 0 and so on.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per quantity, and per sex for sizes. ``off_sd`` is the mean minus the reference mean, divided by the
        reference standard deviation. ``patients`` is the size measured in the same way on patient bones, scaled to the
        reference plateau width, in mm. Label errors are the largest absolute errors of all knees.
    """
    knees = [sample_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="paper") for k in range(count)]
    sizes = map_in_parallel(measure_knee_sizes, knees, shared={}, workers=workers)
    rows: list[Row] = [
        {"quantity": name, "value": float(f"{max(abs(one[name]) for one in sizes):.2g}"), "knees": count}
        for name in ("error of jsw_medial_mm", "error of jsw_lateral_mm", "error of varus_deg")
    ]
    sizes_known = load_reference_tables().morphometry
    plateau = sizes_known["tibial_ml_mm"]
    for name, known in sizes_known.items():
        for sex in ("male", "female", "both"):
            size = getattr(known, sex)
            if size is None:
                continue
            # A small sample may contain no knee of one sex, and a single knee has no standard deviation.
            values = np.array([one[name] for one, knee in zip(sizes, knees, strict=True) if sex in (knee.sex, "both")])
            if len(values) == 0:
                continue
            mean, sd = size
            spread = round(float(values.std(ddof=1)), 2) if len(values) > 1 else ""
            rows.append({
                "quantity": name, "sex": sex, "value": round(float(values.mean()), 2),
                "sd": spread, "knees": len(values), "reference": mean,
                "reference_sd": sd, "off_sd": round(float(values.mean() - mean) / sd, 2),
                "patients": _scale_patient_size(known, sex, plateau), "source": known.source,
            })  # fmt: skip
    return [{name: row.get(name, "") for name in rows[-1]} for row in rows]


def _scale_patient_size(known: ReferenceSize, sex: str, plateau: ReferenceSize) -> float | str:
    """Scale a size of patient bones to the mean reference plateau width of a sex; return "" if it was not measured."""
    wide = [getattr(plateau, name)[0] for name in ("male", "female") if sex in (name, "both")]
    return "" if known.patient_width_ratio is None else round(known.patient_width_ratio * float(np.mean(wide)), 1)


def measure_knee_sizes(knee: Knee) -> Sizes:
    """Measure bone sizes and label errors of one knee.

    Parameters
    ----------
    knee : Knee
        Knee to build. Sizes are measured on a right knee without osteophytes, rotation and flexion.

    Returns
    -------
    dict of str to float
        Sizes in mm and angles in degrees by name, and the signed errors of three labels (``error of ...``).
    """
    spaces = build(knee).measure_jsw_mm(load_protocol("reference"))
    # Published sizes are of dry bones, so osteophytes are removed and each bone is transformed to its own frame.
    bare = replace(knee, osteophytes=(), grade=None, grade_table=None, rotation_deg=0.0, flexion_deg=0.0, side="right")
    built, meshes = build(bare), dict[str, trimesh.Trimesh]()
    for name, bone in built.bones.items():
        meshes |= {
            name: extract_mesh(bone.outer).as_trimesh(),
            f"{name}_trabecular": extract_mesh(bone.inner).as_trimesh(),
        }
    angle = _femorotibial_deg(meshes)
    return {
        **_measure_femur(meshes, built.assembly),
        **_measure_tibia(meshes, built.assembly),
        **_measure_patella(meshes),
        "femorotibial_deg": angle,
        "error of jsw_medial_mm": spaces[0] - knee.jsw_medial_mm,
        "error of jsw_lateral_mm": spaces[1] - knee.jsw_lateral_mm,
        "error of varus_deg": angle - 175.0 - knee.varus_deg,
    }


def _measure_femur(meshes: Mapping[str, trimesh.Trimesh], assembly: KneeAssembly) -> Sizes:
    """Measure sizes of the femur, in mm; z = 0 is the distal end of the condyles."""
    bone, marrow = (
        _undo_transform(meshes[name], assembly.pose.femur_transform()) for name in ("femur", "femur_trabecular")
    )
    s, points = assembly.bone_parameters.scale, bone.vertices
    condyles = points[points[:, 2] < 45 * s]
    # The notch is measured in a frontal plane, one fifth of the condylar depth anterior to the posterior condylar edge.
    behind = condyles[:, 1].max() - 0.2 * np.ptp(condyles[:, 1])
    # The width of a condyle is measured from the epicondyle to the innermost point of the notch wall.
    lines = [_intersect_line(bone, 0, y, z) for y in np.linspace(0.0, behind, 6) for z in (8.0 * s, 12.0 * s)]
    walls = [line[1:3] for line in lines if len(line) == 4]  # A line with four intersections crosses both condyles.
    low = _intersect_line(bone, 0, behind, 10.0 * s)
    # The notch height is measured at the posterior edge of the roof, 4 mm anterior to the posterior shaft surface.
    roof = _intersect_line(bone, 1, 0.0, 50.0 * s)[-1] - 4.0 * s
    return {
        "epicondylar_width_mm": float(np.ptp(points[points[:, 2] < 60 * s, 0])),
        "medial_condyle_ap_mm": float(np.ptp(condyles[condyles[:, 0] > 8 * s, 1])),
        "lateral_condyle_ap_mm": float(np.ptp(condyles[condyles[:, 0] < -8 * s, 1])),
        "lateral_condyle_width_mm": float(max(wall[0] for wall in walls) - condyles[:, 0].min()),
        "medial_condyle_width_mm": float(condyles[:, 0].max() - min(wall[1] for wall in walls)),
        "notch_width_mm": float(low[2] - low[1]),
        "notch_height_mm": float(_intersect_line(bone, 2, 0.0, roof)[0]),
        **_measure_shaft(bone, marrow, 150.0, "femoral_shaft_ml_mm", "femoral_shaft_cortex_mm"),
        **_measure_shaft(bone, marrow, 80.0, "", "femoral_cortex_80_mm"),
    }


def _measure_tibia(meshes: Mapping[str, trimesh.Trimesh], assembly: KneeAssembly) -> Sizes:
    """Measure sizes of tibia and fibula, in mm and degrees; z = 0 is the middle of the plateau."""
    bone, marrow, fibula = (
        _undo_transform(meshes[name], assembly.pose.tibia_transform())
        for name in ("tibia", "tibia_trabecular", "fibula")
    )
    s, points = assembly.bone_parameters.scale, bone.vertices
    top = points[points[:, 2] > -15 * s]
    sizes = {
        "tibial_ml_mm": float(np.ptp(top[:, 0])),
        "tibial_ap_mm": float(np.ptp(top[:, 1])),
        **_measure_shaft(bone, marrow, -130.0, "tibial_shaft_ml_mm", "tibial_shaft_cortex_mm"),
        **_measure_shaft(bone, marrow, -50.0, "", "tibial_cortex_50_mm"),
    }
    tips = []
    for side, sign in (("medial", 1.0), ("lateral", -1.0)):
        x = sign * 22.0 * s
        half = top[top[:, 0] * sign > 14 * s]
        spine = top[top[:, 0] * sign > 1.0]
        tips.append(spine[spine[:, 2].argmax()])
        front, middle, back = (_intersect_line(bone, 2, x, y * s)[-1] for y in (-13.0, 0.0, 13.0))
        sizes[f"{side}_plateau_ap_mm"] = float(np.ptp(half[:, 1]))
        sizes[f"{side}_slope_deg"] = float(np.rad2deg(np.arctan2(front - back, 26.0 * s)))
        sizes[f"{side}_spine_mm"] = float(tips[-1][2] - middle)
    head = fibula.vertices[fibula.vertices[:, 2] > -40 * s]
    return sizes | {
        "spine_spacing_mm": float(tips[0][0] - tips[1][0]),
        "fibular_head_ml_mm": float(np.ptp(head[:, 0])),
        "fibular_tip_below_plateau_mm": float(middle - head[:, 2].max()),
    }


def _measure_patella(meshes: Mapping[str, trimesh.Trimesh]) -> Sizes:
    """Measure width and height of the patella, in mm."""
    wide, _, high = np.ptp(meshes["patella"].vertices, axis=0)
    return {"patellar_width_mm": float(wide), "patellar_height_mm": float(high)}


def _measure_shaft(bone: trimesh.Trimesh, marrow: trimesh.Trimesh, z: float, width_key: str, cortex_key: str) -> Sizes:
    """Measure the shaft width and the mean thickness of medial and lateral cortex at height `z`, in mm."""
    ring = _slice_mesh_at_height(bone, z)
    y = float(ring[:, 1].min() + ring[:, 1].max()) / 2
    outside, inside = (_intersect_line(mesh, 0, y, z) for mesh in (bone, marrow))
    sizes = {cortex_key: float((inside[0] - outside[0] + outside[-1] - inside[-1]) / 2)}
    return sizes | ({width_key: float(np.ptp(ring[:, 0]))} if width_key else {})


def _femorotibial_deg(meshes: Mapping[str, trimesh.Trimesh]) -> float:
    """Measure the lateral angle between femoral and tibial shaft in the frontal plane, in degrees; 180 is straight."""
    lean = 0.0
    for name, heights in (("femur", (115.0, 165.0)), ("tibia", (-115.0, -165.0))):
        rings = [_slice_mesh_at_height(meshes[name], z)[:, 0] for z in heights]
        near, far = ((ring.min() + ring.max()) / 2 for ring in rings)
        lean += np.rad2deg(np.arctan2(far - near, 50.0))
    return float(180.0 + lean)


def _slice_mesh_at_height(mesh: trimesh.Trimesh, z: float) -> Array:
    """Return the (n, 3) corners of a horizontal section of a mesh, in mm."""
    cut = mesh.section(plane_origin=[0.0, 0.0, z], plane_normal=[0.0, 0.0, 1.0])
    assert cut is not None
    return np.asarray(cut.vertices)


def _intersect_line(mesh: trimesh.Trimesh, axis: int, first: float, second: float) -> Array:
    """Return the sorted coordinates, in mm, at which a line along an axis crosses a mesh.

    `first` and `second` are the other two coordinates of the line, in the order x, y, z.
    """
    start = np.insert([first, second], axis, -400.0)
    places, _, _ = mesh.ray.intersects_location([start], [np.eye(3)[axis]])
    return np.sort(places[:, axis])


def _undo_transform(mesh: trimesh.Trimesh, transform: Array) -> trimesh.Trimesh:
    """Apply the inverse of a rigid (3, 4) transform to a mesh."""
    points = (mesh.vertices - transform[:, 3]) @ transform[:, :3]
    return trimesh.Trimesh(points, mesh.faces, process=False)
