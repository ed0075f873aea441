"""Minimal distance between the bones in each compartment, which a radiograph does not show."""

from manifold3d import Manifold

from ..anatomy import BuiltKnee
from ..anatomy.meshing.solids import build_solid
from ..anatomy.outlines.projected_contours import COMPARTMENT_RANGE

# Height of the parts of the femur above and of the tibia below the origin, in mm. The joint space is between them.
_FEMUR_TO_MM = 25.0
_TIBIA_TO_MM = 15.0
# First and largest distance within which the nearest points are searched for, in mm. The search takes longer for a
# larger distance.
_FIRST_SEARCH_MM = 4.0
_LARGEST_SEARCH_MM = 32.0


def measure_minimal_distances(built: BuiltKnee) -> tuple[float, float]:
    """Measure the minimal distance between femur and tibia in three dimensions, with osteophytes.

    Parameters
    ----------
    built : BuiltKnee
        Built knee without surgery.

    Returns
    -------
    tuple of float
        Minimal distances in the medial and the lateral compartment, in mm, in the range of positions in which the joint
        space is measured on radiographs. At most 32 mm.
    """
    meshes = {surface.name: surface.mesh_arrays for surface in built.scene.surfaces}
    femur, tibia = (build_solid(meshes[name].vertices, meshes[name].faces, name) for name in ("femur", "tibia"))
    femur = femur.trim_by_plane((0.0, 0.0, -1.0), -_FEMUR_TO_MM)
    tibia = tibia.trim_by_plane((0.0, 0.0, 1.0), -_TIBIA_TO_MM)
    medial = 1 if built.knee.side == "right" else -1
    inner, outer = (share * built.assembly.bone_parameters.half_ml_mm for share in COMPARTMENT_RANGE)
    slabs = [sorted((side * inner, side * outer)) for side in (medial, -medial)]
    first, second = (_measure_gap_mm(_cut_slab(femur, low, high), _cut_slab(tibia, low, high)) for low, high in slabs)
    return first, second


def _cut_slab(solid: Manifold, low_mm: float, high_mm: float) -> Manifold:
    """Return the part of a solid between two sagittal planes."""
    return solid.trim_by_plane((1.0, 0.0, 0.0), low_mm).trim_by_plane((-1.0, 0.0, 0.0), -high_mm)


def _measure_gap_mm(one: Manifold, other: Manifold) -> float:
    """Return the minimal distance between two solids, in mm."""
    search_mm = _FIRST_SEARCH_MM
    while (gap_mm := one.min_gap(other, search_mm)) >= search_mm and search_mm < _LARGEST_SEARCH_MM:
        search_mm *= 2
    return float(gap_mm)
