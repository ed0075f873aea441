"""Drawn knees measured on their meshes and projections: sizes beside published ones, and errors of the labels."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import trimesh

from ..anatomy import build
from ..anatomy.joint import KneeAssembly
from ..anatomy.solids import mesh_of
from ..core.checks import Array
from ..core.parallel import ordered_map
from ..data.references import Size, references
from ..model.draw import draw_knee
from ..model.knee import Knee
from ..model.protocol import load_protocol
from .engines import Row

Sizes = dict[str, float]


def knee_rows(count: int, workers: int) -> list[Row]:
    """One row a quantity, over drawn knees of all grades: errors of the labels, and sizes measured on the meshes.

    off_sd  mean minus reference over the reference's standard deviation
    people  the size of people's bones by the same measure, at the reference's width of the plateau, mm
    """
    knees = [draw_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="paper") for k in range(count)]
    sizes = ordered_map(measured, knees, shared={}, workers=workers)
    rows: list[Row] = [
        {"quantity": name, "value": float(f"{max(abs(one[name]) for one in sizes):.2g}"), "knees": count}
        for name in ("error of jsw_medial_mm", "error of jsw_lateral_mm", "error of varus_deg")
    ]
    sizes_known = references().morphometry
    plateau = sizes_known["tibial_ml_mm"]
    for name, known in sizes_known.items():
        for sex in ("male", "female", "both"):
            size = getattr(known, sex)
            if size is None:
                continue
            # Of so few knees none may be of a sex, and one alone has no spread.
            values = np.array([one[name] for one, knee in zip(sizes, knees, strict=True) if sex in (knee.sex, "both")])
            if len(values) == 0:
                continue
            mean, sd = size
            spread = round(float(values.std(ddof=1)), 2) if len(values) > 1 else ""
            rows.append({
                "quantity": name, "sex": sex, "value": round(float(values.mean()), 2),
                "sd": spread, "knees": len(values), "reference": mean,
                "reference_sd": sd, "off_sd": round(float(values.mean() - mean) / sd, 2),
                "people": _people(known, sex, plateau), "source": known.source,
            })  # fmt: skip
    return [{name: row.get(name, "") for name in rows[-1]} for row in rows]


def _people(known: Size, sex: str, plateau: Size) -> float | str:
    """A size of people's bones at the mean width of the plateau of a sex, or of both; "" where none was measured."""
    wide = [getattr(plateau, name)[0] for name in ("male", "female") if sex in (name, "both")]
    return "" if known.people is None else round(known.people * float(np.mean(wide)), 1)


def measured(knee: Knee) -> Sizes:
    """Sizes of one knee, and the errors of its labels; largest over a cohort they are what `knee_rows` tells."""
    spaces = build(knee).measured_jsw_mm(load_protocol("reference"))
    # Bones alone, as they are measured dry: without osteophytes, and each turned back into its own frame.
    bare = replace(knee, osteophytes=(), grade=None, grade_table=None, rotation_deg=0.0, flexion_deg=0.0, side="right")
    built, meshes = build(bare), dict[str, trimesh.Trimesh]()
    for name, bone in built.bones.items():
        meshes |= {name: mesh_of(bone.outer).as_trimesh(), f"{name}_trabecular": mesh_of(bone.inner).as_trimesh()}
    angle = _femorotibial_deg(meshes)
    return {
        **_femur(meshes, built.assembly),
        **_tibia(meshes, built.assembly),
        **_patella(meshes),
        "femorotibial_deg": angle,
        "error of jsw_medial_mm": spaces[0] - knee.jsw_medial_mm,
        "error of jsw_lateral_mm": spaces[1] - knee.jsw_lateral_mm,
        "error of varus_deg": angle - 175.0 - knee.varus_deg,
    }


def _femur(meshes: Mapping[str, trimesh.Trimesh], assembly: KneeAssembly) -> Sizes:
    """z = 0 at the condyles' distal end."""
    bone, marrow = (_back(meshes[name], assembly.pose.femur()) for name in ("femur", "femur_trabecular"))
    s, points = assembly.build.scale, bone.vertices
    condyles = points[points[:, 2] < 45 * s]
    # As seen from behind, a fifth of the depth in front of the condyles' back.
    behind = condyles[:, 1].max() - 0.2 * np.ptp(condyles[:, 1])
    # A condyle reaches from its epicondyle to the innermost place of its wall of the notch.
    lines = [_line(bone, 0, y, z) for y in np.linspace(0.0, behind, 6) for z in (8.0 * s, 12.0 * s)]
    walls = [line[1:3] for line in lines if len(line) == 4]  # through both condyles
    low = _line(bone, 0, behind, 10.0 * s)
    # The roof's back edge, where the notch is highest, lies under the back of the shaft.
    roof = _line(bone, 1, 0.0, 50.0 * s)[-1] - 4.0 * s
    return {
        "epicondylar_width_mm": float(np.ptp(points[points[:, 2] < 60 * s, 0])),
        "medial_condyle_ap_mm": float(np.ptp(condyles[condyles[:, 0] > 8 * s, 1])),
        "lateral_condyle_ap_mm": float(np.ptp(condyles[condyles[:, 0] < -8 * s, 1])),
        "lateral_condyle_width_mm": float(max(wall[0] for wall in walls) - condyles[:, 0].min()),
        "medial_condyle_width_mm": float(condyles[:, 0].max() - min(wall[1] for wall in walls)),
        "notch_width_mm": float(low[2] - low[1]),
        "notch_height_mm": float(_line(bone, 2, 0.0, roof)[0]),
        **_shaft(bone, marrow, 150.0, "femoral_shaft_ml_mm", "femoral_shaft_cortex_mm"),
        **_shaft(bone, marrow, 80.0, "", "femoral_cortex_80_mm"),
    }


def _tibia(meshes: Mapping[str, trimesh.Trimesh], assembly: KneeAssembly) -> Sizes:
    """z = 0 at the middle of the plateau."""
    bone, marrow, fibula = (
        _back(meshes[name], assembly.pose.tibia()) for name in ("tibia", "tibia_trabecular", "fibula")
    )
    s, points = assembly.build.scale, bone.vertices
    top = points[points[:, 2] > -15 * s]
    sizes = {
        "tibial_ml_mm": float(np.ptp(top[:, 0])),
        "tibial_ap_mm": float(np.ptp(top[:, 1])),
        **_shaft(bone, marrow, -130.0, "tibial_shaft_ml_mm", "tibial_shaft_cortex_mm"),
        **_shaft(bone, marrow, -50.0, "", "tibial_cortex_50_mm"),
    }
    tips = []
    for side, sign in (("medial", 1.0), ("lateral", -1.0)):
        x = sign * 22.0 * s
        half = top[top[:, 0] * sign > 14 * s]
        spine = top[top[:, 0] * sign > 1.0]
        tips.append(spine[spine[:, 2].argmax()])
        front, middle, back = (_line(bone, 2, x, y * s)[-1] for y in (-13.0, 0.0, 13.0))
        sizes[f"{side}_plateau_ap_mm"] = float(np.ptp(half[:, 1]))
        sizes[f"{side}_slope_deg"] = float(np.rad2deg(np.arctan2(front - back, 26.0 * s)))
        sizes[f"{side}_spine_mm"] = float(tips[-1][2] - middle)
    head = fibula.vertices[fibula.vertices[:, 2] > -40 * s]
    return sizes | {
        "spine_spacing_mm": float(tips[0][0] - tips[1][0]),
        "fibular_head_ml_mm": float(np.ptp(head[:, 0])),
        "fibular_tip_below_plateau_mm": float(middle - head[:, 2].max()),
    }


def _patella(meshes: Mapping[str, trimesh.Trimesh]) -> Sizes:
    wide, _, high = np.ptp(meshes["patella"].vertices, axis=0)
    return {"patellar_width_mm": float(wide), "patellar_height_mm": float(high)}


def _shaft(bone: trimesh.Trimesh, marrow: trimesh.Trimesh, z: float, width: str, cortex: str) -> Sizes:
    """Width across a shaft at a height, and the mean thickness of its two walls there."""
    ring = _ring(bone, z)
    y = float(ring[:, 1].min() + ring[:, 1].max()) / 2
    outside, inside = (_line(mesh, 0, y, z) for mesh in (bone, marrow))
    sizes = {cortex: float((inside[0] - outside[0] + outside[-1] - inside[-1]) / 2)}
    return sizes | ({width: float(np.ptp(ring[:, 0]))} if width else {})


def _femorotibial_deg(meshes: Mapping[str, trimesh.Trimesh]) -> float:
    """Lateral angle between the shafts in the frontal plane, 180 where they are in line."""
    lean = 0.0
    for name, heights in (("femur", (115.0, 165.0)), ("tibia", (-115.0, -165.0))):
        rings = [_ring(meshes[name], z)[:, 0] for z in heights]
        near, far = ((ring.min() + ring.max()) / 2 for ring in rings)
        lean += np.rad2deg(np.arctan2(far - near, 50.0))
    return float(180.0 + lean)


def _ring(mesh: trimesh.Trimesh, z: float) -> Array:
    """(n, 3)  corners of the outline of a mesh at a height that it reaches"""
    cut = mesh.section(plane_origin=[0.0, 0.0, z], plane_normal=[0.0, 0.0, 1.0])
    assert cut is not None
    return np.asarray(cut.vertices)


def _line(mesh: trimesh.Trimesh, axis: int, first: float, second: float) -> Array:
    """Where a line along an axis meets a mesh, in order; first and second are its other two coordinates, x before z."""
    start = np.insert([first, second], axis, -400.0)
    places, _, _ = mesh.ray.intersects_location([start], [np.eye(3)[axis]])
    return np.sort(places[:, axis])


def _back(mesh: trimesh.Trimesh, transform: Array) -> trimesh.Trimesh:
    """A mesh as it was before a rigid (3, 4) transform."""
    points = (mesh.vertices - transform[:, 3]) @ transform[:, :3]
    return trimesh.Trimesh(points, mesh.faces, process=False)
