"""People's bones brought into the frames of the mean man's: size, pose, slope and lean of the shaft taken out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ..anatomy.bone_build import Build, Form, build_of, plateau_fall, stand_femur, stand_tibia
from ..anatomy.small_bones import patella
from ..anatomy.solids import mesh_of
from ..core.checks import Array
from ..data.anatomy import AnatomyTables
from ..geometry.freeform import Lattice, with_displacements
from ..geometry.mesh import Mesh
from ..model.knee import Knee
from .bone_fit import fit_bone
from .surfaces import MeasuredSurface, Similarity, measured

Frame = Callable[[Array], Array]
# Of the tibia, in which its plateau is widest.
_PLATEAU_MM = 25.0
_ROUNDS = 15


def mean_bones(man: Build) -> dict[str, Mesh]:
    """Femur, tibia and patella of `mean_man`, each in its own frame (mm), before they stand."""
    small = mesh_of(patella(man).outer)
    return {
        "femur": mesh_of(man.mean_femur.outer),
        "tibia": mesh_of(man.mean_tibia.outer),
        # In the frame of his femur, where its lattice acts.
        "patella": Mesh(small.vertices + man.shape.patella.centre_mm, small.faces),
    }


def mean_man(tables: AnatomyTables) -> Build:
    """The mean man, whose bones no lattice deforms."""
    build = build_of(Knee(), tables)
    none = {
        name: with_displacements(lattice, 0 * lattice.displacements_mm) for name, lattice in _lattices(build).items()
    }
    tibia = Form(lattice=none["tibia"], end=-1)
    return replace(
        build,
        femur=Form(lattice=none["femur"], end=+1),
        tibia=tibia,
        fall=plateau_fall(tibia, build.shape.tibia),
        patella=none["patella"],
        femur_valgus_deg=build.shape.femur.valgus_deg,
        tibia_varus_deg=0.0,
    )


def _lattices(build: Build) -> dict[str, Lattice]:
    return {"femur": build.femur.lattice, "tibia": build.tibia.lattice, "patella": build.patella}


def stand(points_mm: Array, name: str, man: Build) -> Array:
    """(n, 3)  places of the mean man's bone as it stands, undeformed

    points_mm  (n, 3)
    man        of `mean_man`
    """
    how = {"femur": stand_femur, "tibia": stand_tibia}.get(name)
    return how(points_mm, man) if how else points_mm


def unstand(places_mm: Array, name: str, man: Build) -> Array:
    """(n, 3)  the points that `stand` takes to places

    places_mm  (n, 3)
    man        of `mean_man`
    """
    points = np.array(places_mm, np.float64)
    for _ in range(_ROUNDS):
        points += places_mm - stand(points, name, man)
    return points


def own_frames(
    built: Mapping[str, Mesh],
    people: Mapping[str, MeasuredSurface],
    poses: Mapping[str, Sequence[Similarity]],
    man: Build,
) -> dict[str, Frame]:
    """Bone -> what takes places on the mean of people's bones, (n, 3) mm, into the frame of the mean man's.

    The mean is turned as people's bones are on the average in the axes they are given in, not as it would cover the
    mean man's best, which would trade the slope of the plateau and the lean of shafts for it. One size is taken for all
    three bones, that of the tibial plateau's width, which stays what it was; femur and tibia keep their places across
    one another, so that people's bones go on fitting. The femur's distal end stays at height 0, the plateau at its own.
    built  as it is before it stands
    poses  what lays each knee's bone onto the mean
    man    of `mean_man`
    """
    standing = {name: Mesh(stand(bone.vertices, name, man), bone.faces) for name, bone in built.items()}
    rest = {name: _mean_rest(poses[name], people[name].mesh) for name in built}
    placed = {name: Mesh(rest[name].apply(people[name].mesh.vertices), people[name].mesh.faces) for name in built}
    plateau, given = _plateau_box(standing["tibia"]), _plateau_box(placed["tibia"])
    scale = float(np.ptp(plateau[:, 0]) / np.ptp(given[:, 0]))
    across = plateau.mean(axis=0) - scale * given.mean(axis=0)
    heights = {
        "femur": -scale * placed["femur"].vertices[:, 2].min(),
        "tibia": _plateau_level(standing["tibia"]) - scale * _plateau_level(placed["tibia"]),
    }
    frames = dict[str, Frame]()
    for name in built:
        shift = _box(standing[name].vertices).mean(axis=0) - scale * _box(placed[name].vertices).mean(axis=0)
        if name in heights:
            shift = np.array([across[0], across[1], heights[name]])
        whole = Similarity(
            rotation=rest[name].rotation, scale=scale * rest[name].scale, shift_mm=scale * rest[name].shift_mm + shift
        )
        frames[name] = partial(_into, fit=whole, name=name, man=man)
    return frames


def in_frame(bone: Mesh, frame: Frame) -> MeasuredSurface:
    """A bone of people, laid onto their mean, in the frame of the mean man's."""
    return measured(Mesh(frame(np.asarray(bone.vertices, np.float64)), bone.faces))


def pose_of(bone: Mesh, onto: MeasuredSurface, name: str) -> Similarity:
    """The similarity that lays a bone onto the mean of its kind: pose and size."""
    return fit_bone(bone, onto, name).fit


def _into(places_mm: Array, fit: Similarity, name: str, man: Build) -> Array:
    return unstand(fit.apply(places_mm), name, man)


def _mean_rest(poses: Sequence[Similarity], mean: Mesh) -> Similarity:
    """Where the mean of bones is on the average of where they are themselves."""
    back = Rotation.from_matrix([pose.rotation.T for pose in poses]).mean().as_matrix()
    middle = _box(mean.vertices).mean(axis=0)
    scale = float(np.exp(-np.mean([np.log(pose.scale) for pose in poses])))
    there = np.mean([pose.undo(middle[None])[0] for pose in poses], axis=0)
    return Similarity(rotation=back, scale=scale, shift_mm=there - scale * back @ middle)


def _box(points: Array) -> Array:
    return np.stack((points.min(axis=0), points.max(axis=0)))


def _plateau_box(tibia: Mesh) -> Array:
    return _box(tibia.vertices[tibia.vertices[:, 2] > tibia.vertices[:, 2].max() - _PLATEAU_MM])


def _plateau_level(tibia: Mesh) -> float:
    """Height of both plateaus' middles."""
    (low, _, _), (high, _, top) = _plateau_box(tibia)
    share = (tibia.vertices[:, 0] - low) / (high - low)
    level = (tibia.as_trimesh().vertex_normals[:, 2] > 0.8) & (tibia.vertices[:, 2] > top - _PLATEAU_MM)
    sides = [level & (share > start) & (share < start + 0.2) for start in (0.12, 0.68)]
    return float(np.mean([np.median(tibia.vertices[side, 2]) for side in sides]))
