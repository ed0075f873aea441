"""Scene geometry: projection views, closed surfaces, density fields and mesh repair.

====================  =====================================================================
view                  source, detector and projection in the knee frame
scene                 closed surfaces between materials
density               relative densities that vary within a material
mesh                  triangle meshes, with conversion to trimesh
mesh_repair           repair of meshes, and errors for meshes that do not bound a solid
mesh_topology         edges, duplicates, connected components and volumes of meshes
mesh_nesting          detection of components that are inside out and not cavities
mesh_containment      tests for meshes that contain each other or are disjoint
mesh_cut              cutting of a closed mesh at a given height
freeform_deformation  deformation of points by a lattice of control points
====================  =====================================================================
"""

from .view import (
    View,
    magnification,
    project_points,
    resolve_view,
)

__all__ = ["View", "magnification", "project_points", "resolve_view"]
