"""Osteophyte masks: select the bone faces that osteophytes raise above the surface without osteophytes."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...core.checks import Array
from ...geometry.mesh import Indices, Mesh
from ...model.knee import Knee
from ..bones.osteophyte_growth import BoneWithOsteophytes
from ..posture.knee_assembly import KneeAssembly
from ..template.template_bone import TemplateBone

# Smallest protrusion from the surface without osteophytes at which bone belongs to an osteophyte, in mm.
MIN_PROTRUSION_MM = 0.05


def select_osteophyte_faces(knee: Knee, assembly: KneeAssembly) -> dict[str, Mesh]:
    """Select the bone faces that protrude from the surface without osteophytes, for each site.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee, including its osteophytes.
    assembly : KneeAssembly
        Bones of the knee in their pose.

    Returns
    -------
    dict of str to Mesh
        Open mesh per site in the knee frame, in mm. Its border is 0.05 mm above the surface without osteophytes. An
        osteophyte that does not protrude has no faces.
    """
    selected = {}
    for template, grown, place_points, sites in list_bones_with_osteophytes(knee, assembly):
        raised = select_raised_faces(template, grown)
        raised = Mesh(place_points(raised.vertices), raised.faces)
        tips = place_points(np.array([shape.tip for shape in grown.shapes]))
        for site, mesh in _split_faces_by_site(raised, sites, tips).items():
            selected[site] = assembly.orient_mesh(mesh)
    return selected


def list_bones_with_osteophytes(
    knee: Knee, assembly: KneeAssembly
) -> list[tuple[TemplateBone, BoneWithOsteophytes, Callable[[Array], Array], list[str]]]:
    """List femur and tibia, if they have osteophytes.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee, including its osteophytes.
    assembly : KneeAssembly
        Bones of the knee in their pose.

    Returns
    -------
    list of tuple
        Template bone, bone with osteophytes, function that maps points (n, 3) of the template, in mm, into the posed
        leg, and site of each osteophyte.
    """
    template = assembly.bone_parameters
    bones = (
        (template.template_femur, assembly.femur, assembly.place_femur_points),
        (template.template_tibia, assembly.tibia, assembly.place_tibia_points),
    )
    listed = [(*bone, [one.site for one in knee.osteophytes if one.bone == bone[0].name]) for bone in bones]
    return [bone for bone in listed if bone[3]]


def select_raised_faces(template: TemplateBone, grown: BoneWithOsteophytes) -> Mesh:
    """Select the faces of a bone that protrude from the template bone.

    Parameters
    ----------
    template : TemplateBone
        Bone without osteophytes.
    grown : BoneWithOsteophytes
        The same bone with one or more osteophytes.

    Returns
    -------
    Mesh
        Open mesh at template size in the frame of the bone, in mm. Its border is 0.05 mm above the template bone.
    """
    near = np.any([shape.is_near(grown.mesh.vertices) for shape in grown.shapes], axis=0)
    protrusion_mm = np.full(len(near), -MIN_PROTRUSION_MM)
    protrusion_mm[near] += template.field(grown.mesh.vertices[near])
    return _clip_faces(grown.mesh, protrusion_mm)


def _clip_faces(mesh: Mesh, values: Array) -> Mesh:
    """Keep the part of a mesh in which `values` (n,), interpolated linearly over each face, are positive."""
    positive = values > 0
    count = positive[mesh.faces].sum(axis=1)
    crossed = (count == 1) | (count == 2)
    cut = mesh.faces[crossed]
    # The corners of each crossed face are rotated, so that the first corner is the only one of its sign.
    first = (positive[cut] == (count[crossed] == 1)[:, None]).argmax(axis=1)
    one, two, three = np.take_along_axis(cut, (first[:, None] + np.arange(3)) % 3, axis=1).T
    edges, number = np.unique(
        np.sort(np.concatenate((np.column_stack((one, two)), np.column_stack((three, one)))), axis=1),
        axis=0,
        return_inverse=True,
    )
    after, before = np.split(number.reshape(-1) + len(mesh.vertices), 2)
    start, stop = values[edges].T
    fraction = (start / (start - stop))[:, None]
    added = mesh.vertices[edges[:, 0]] * (1 - fraction) + mesh.vertices[edges[:, 1]] * fraction
    alone = positive[one]
    faces = (
        mesh.faces[count == 3],
        np.column_stack((one, after, before))[alone],
        np.column_stack((after, two, three))[~alone],
        np.column_stack((after, three, before))[~alone],
    )
    return _drop_unused_vertices(np.vstack((mesh.vertices, added)), np.vstack(faces))


def _drop_unused_vertices(vertices: Array, faces: Indices) -> Mesh:
    """Remove the vertices that no face of a mesh uses."""
    used, number = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], number.reshape(-1, 3))


def _split_faces_by_site(mesh: Mesh, sites: list[str], tips: Array) -> dict[str, Mesh]:
    """Split the faces that osteophytes raise into one mesh per site; each connected component belongs to one site.

    `tips` (n, 3) are the tips of the osteophytes at `sites`. A component with the tips of several sites, such as both
    tibial spines, is cut halfway between these tips. A component without a tip belongs to the nearest tip.
    """
    parts: dict[str, list[Mesh]] = {site: [] for site in sites}
    if not len(mesh.faces):
        return {site: _join_meshes([]) for site in parts}
    ends = mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]
    links = coo_array((np.ones(2 * len(mesh.faces)), np.vstack(ends).T), shape=(len(mesh.vertices),) * 2)
    count, label = connected_components(links, directed=False)
    for component in range(count):
        piece = _drop_unused_vertices(mesh.vertices, mesh.faces[label[mesh.faces[:, 0]] == component])
        owners = find_owners(piece.vertices.min(axis=0), piece.vertices.max(axis=0), sites, tips)
        for owner in owners:
            others = [other for other in owners if sites[other] != sites[owner]]
            parts[sites[owner]].append(_trim_to_nearest_tip(piece, tips[owner], tips[others]))
    return {site: _join_meshes(meshes) for site, meshes in parts.items()}


def find_owners(low_mm: Array, high_mm: Array, sites: list[str], tips: Array) -> list[int]:
    """Find the osteophytes to which a connected component belongs.

    Parameters
    ----------
    low_mm, high_mm : (3,) float64 array
        Corners of the bounding box of the component, in mm.
    sites : list of str
        Site of each osteophyte.
    tips : (n, 3) float64 array
        Tip of each osteophyte, in mm.

    Returns
    -------
    list of int
        Indices of all osteophytes with tips in the box if these have several sites; otherwise the index of the
        osteophyte whose tip is nearest to the centre of the box.
    """
    inside = np.flatnonzero(((tips >= low_mm) & (tips <= high_mm)).all(axis=1)).tolist()
    if len({sites[number] for number in inside}) > 1:
        return inside
    return [int(np.linalg.norm(tips - (low_mm + high_mm) / 2, axis=1).argmin())]


def _trim_to_nearest_tip(piece: Mesh, tip: Array, others: Array) -> Mesh:
    """Trim a mesh to the part that is nearer to `tip` (3,) than to the other tips (n, 3)."""
    for other in others:
        direction = (tip - other) / np.linalg.norm(tip - other)
        piece = _clip_faces(piece, (piece.vertices - (tip + other) / 2) @ direction)
    return piece


def _join_meshes(meshes: list[Mesh]) -> Mesh:
    """Join meshes into one mesh without merging their vertices."""
    if not meshes:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    shifts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + shift for mesh, shift in zip(meshes, shifts, strict=True)]
    return Mesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces))
