"""Labels of a radiograph that shows the knee in a lateral or axial view.

JSW and contour landmarks exist only in frontal views. The labels of lateral and axial views are projected points of the
bones, including osteophytes:

``joint_centre``
    Origin of the knee frame: centre of the joint line between both plateaus.
``medial_plateau_anterior``, ``medial_plateau_posterior``, ``lateral_plateau_anterior``, ``lateral_plateau_posterior``
    Anterior and posterior margin of each plateau (see `posture.plateau_margins`).
``fibula_tip``
    Highest point of the fibula along the axis of the tibia.
``patella_apex``
    Point of the patella nearest to the tibial attachment of its tendon.
``patella_base``
    Point of the patella farthest from the apex.

An axial view adds three points on the upper outline of the femur. ``trochlea_lateral`` and ``trochlea_medial`` are the
highest lateral and medial points, and ``sulcus`` is the lowest point between them.
"""

import numpy as np

from ...core.checks import Array
from ...geometry.mesh import Mesh
from ...geometry.view import View, project_points
from ...model.knee import Knee
from ...model.radiograph import Truth
from ..bones.bone_shells import Bone
from ..meshing.rigid_pose import apply_transform
from ..meshing.solids import extract_mesh, find_closed_mesh_edges
from ..outlines.projected_contours import compute_outline_rows
from ..posture.knee_assembly import KneeAssembly
from ..posture.plateau_margins import SIDE_SIGNS, find_plateau_margins

# Largest medio-lateral distance of the trochlea from the centre of the knee, as a fraction of half the plateau width
# (assumed).
_TROCHLEA_FRACTION = 0.75


def measure_lateral_axial_labels(knee: Knee, assembly: KneeAssembly, bones: dict[str, Bone], view: View) -> Truth:
    """Measure the labels of a radiograph in a lateral or axial view.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    bones : dict of str to Bone
        Solids of each bone in the frame of the leg, before rotation and mirroring for the view.
    view : View
        Source and detector.

    Returns
    -------
    Truth
        Reader grade and landmarks; JSW is None.
    """
    outer = {name: extract_mesh(bone.outer) for name, bone in bones.items()}
    places = find_bone_landmarks_mm(assembly, outer)
    seen = project_points(assembly.orient_points(np.array(list(places.values()))), view)
    spots = {name: (float(row), float(col)) for name, (row, col) in zip(places, seen, strict=True)}
    if assembly.posture.projection == "axial":
        spots |= find_trochlea_px(assembly, outer["femur"], view)
    return Truth(
        jsw_medial_mm=None,
        jsw_lateral_mm=None,
        reader_grade=knee.reader_grade,
        landmarks_px=spots,
    )


def find_bone_landmarks_mm(assembly: KneeAssembly, outer: dict[str, Mesh]) -> dict[str, Array]:
    """Find the landmarks on the bones that are projected in every view.

    Parameters
    ----------
    assembly : KneeAssembly
        Bones of the knee in their pose.
    outer : dict of str to Mesh
        Outer surface of each bone in the frame of the leg, in mm.

    Returns
    -------
    dict of str to (3,) float64 array
        Position of each landmark in the frame of the leg, in mm.
    """
    tibia, scale = assembly.pose.tibia_transform(), assembly.bone_parameters.scale
    places: dict[str, Array] = {"joint_centre": np.zeros(3)}
    for side in SIDE_SIGNS:
        margins = find_plateau_margins(assembly, outer["tibia"], side)
        places |= {f"{side}_plateau_anterior": margins[0], f"{side}_plateau_posterior": margins[1]}
    up, fibula, patella = tibia[:, 2], outer["fibula"].vertices, outer["patella"].vertices
    tuberosity = apply_transform(np.array([assembly.bone_parameters.shape.patellar_tendon.tuberosity]) * scale, tibia)[
        0
    ]
    apex = patella[np.linalg.norm(patella - tuberosity, axis=1).argmin()]
    base = patella[np.linalg.norm(patella - apex, axis=1).argmax()]
    return places | {"fibula_tip": fibula[(fibula @ up).argmax()], "patella_apex": apex, "patella_base": base}


def find_trochlea_px(assembly: KneeAssembly, femur: Mesh, view: View) -> dict[str, tuple[float, float]]:
    """Find the medial and lateral highest points of the trochlea, and the sulcus between them, in an axial view.

    Parameters
    ----------
    assembly : KneeAssembly
        Bones of the knee in their pose.
    femur : Mesh
        Outer surface of the femur in the frame of the leg, in mm.
    view : View
        Source and detector.

    Returns
    -------
    dict of str to tuple of float
        Row and column of each landmark, in pixels.
    """
    half = _TROCHLEA_FRACTION * assembly.bone_parameters.half_ml_mm
    ends = assembly.orient_points(np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0]]))
    lateral, medial = project_points(ends, view)[:, 1]
    first, last = sorted((round(lateral), round(medial)))
    rows = compute_outline_rows(
        project_points(assembly.orient_points(femur.vertices), view),
        find_closed_mesh_edges(femur.faces),
        first,
        last - first + 1,
        -1.0,
    )
    middle = len(rows) // 2
    left, right = int(rows[:middle].argmin()), middle + int(rows[middle:].argmin())
    low = left + int(rows[left : right + 1].argmax())
    names = ("trochlea_lateral", "sulcus", "trochlea_medial")
    columns = (left, low, right) if lateral < medial else (right, low, left)
    return {name: (float(rows[k]), float(first + k)) for name, k in zip(names, columns, strict=True)}
