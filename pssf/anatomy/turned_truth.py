"""What is known about a radiograph of a knee that is seen from its side or along the leg.

Joint space and contour landmarks are of a knee seen from the front, and are left out. Told are places of the bones
themselves, osteophytes and all, which have a place in every view:

joint_centre                        the origin: the middle of the joint line, between both plateaus
*_plateau_anterior, ..._posterior   the margins of the medial and the lateral plateau (`anatomy.plateau`)
fibula_tip                          the fibula's highest place along the tibia
patella_apex, patella_base          the patella's place nearest to its tendon's end, and that farthest from the apex

On an axial view also, on the femur's upper outline: trochlea_lateral and trochlea_medial, its highest places on either
side, and sulcus, the lowest between them.
"""

import numpy as np

from ..core.checks import Array
from ..geometry.mesh import Mesh
from ..geometry.view import View, project
from ..model.knee import Knee
from ..model.radiograph import Truth
from .bones import Bone
from .contours import envelope
from .joint import KneeAssembly
from .plateau import SIDES, plateau_margins
from .pose import moved
from .solids import closed_edges, mesh_of

# The trochlea lies within this share of half the plateau's width from the middle (judgement).
_TROCHLEA = 0.75


def turned_labels(knee: Knee, assembly: KneeAssembly, bones: dict[str, Bone], view: View) -> Truth:
    """What is known about the radiograph of a knee in a view from its side or along the leg.

    assembly  how it stands
    bones     by name, in the leg as it stands
    """
    outer = {name: mesh_of(bone.outer) for name, bone in bones.items()}
    places = turned_places(assembly, outer)
    seen = project(assembly.seen(np.array(list(places.values()))), view)
    spots = {name: (float(row), float(col)) for name, (row, col) in zip(places, seen, strict=True)}
    if assembly.posture.projection == "axial":
        spots |= trochlea_px(assembly, outer["femur"], view)
    return Truth(
        jsw_medial_mm=None,
        jsw_lateral_mm=None,
        grade_read=knee.grade_read,
        landmarks_px=spots,
    )


def turned_places(assembly: KneeAssembly, outer: dict[str, Mesh]) -> dict[str, Array]:
    """Landmark -> (3,) its place in the leg as it stands, mm

    outer  bone -> its outer surface, likewise
    """
    tibia, scale = assembly.pose.tibia(), assembly.build.scale
    places: dict[str, Array] = {"joint_centre": np.zeros(3)}
    for side in SIDES:
        margins = plateau_margins(assembly, outer["tibia"], side)
        places |= {f"{side}_plateau_anterior": margins[0], f"{side}_plateau_posterior": margins[1]}
    up, fibula, patella = tibia[:, 2], outer["fibula"].vertices, outer["patella"].vertices
    tuberosity = moved(np.array([assembly.build.shape.patellar_tendon.tuberosity]) * scale, tibia)[0]
    apex = patella[np.linalg.norm(patella - tuberosity, axis=1).argmin()]
    base = patella[np.linalg.norm(patella - apex, axis=1).argmax()]
    return places | {"fibula_tip": fibula[(fibula @ up).argmax()], "patella_apex": apex, "patella_base": base}


def trochlea_px(assembly: KneeAssembly, femur: Mesh, view: View) -> dict[str, tuple[float, float]]:
    """Landmark -> (row, column) of the trochlea's outline on an axial view

    femur  its outer surface in the leg as it stands
    """
    half = _TROCHLEA * assembly.build.half_ml_mm
    ends = assembly.seen(np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0]]))
    lateral, medial = project(ends, view)[:, 1]
    first, last = sorted((round(lateral), round(medial)))
    rows = envelope(
        project(assembly.seen(femur.vertices), view), closed_edges(femur.faces), first, last - first + 1, -1.0
    )
    middle = len(rows) // 2
    left, right = int(rows[:middle].argmin()), middle + int(rows[middle:].argmin())
    low = left + int(rows[left : right + 1].argmax())
    names = ("trochlea_lateral", "sulcus", "trochlea_medial")
    columns = (left, low, right) if lateral < medial else (right, low, left)
    return {name: (float(rows[k]), float(first + k)) for name, k in zip(names, columns, strict=True)}
