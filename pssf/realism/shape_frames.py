"""People's bones brought into the frames of the mean man's: size, pose, slope and lean of the shaft taken out."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from ..anatomy.bones import build_of, patella, stand_femur, stand_tibia
from ..anatomy.femur import mean_femur
from ..anatomy.solids import mesh_of
from ..anatomy.tibia import mean_tibia
from ..core.checks import Array
from ..data.bones import mean_shape
from ..geometry.mesh import Mesh
from ..model.knee import Knee
from .bones import fit_bone, near_joint
from .surfaces import MeasuredSurface, Similarity, measured

Frame = Callable[[Array], Array]
# Of the tibia, in which its plateau is widest.
_PLATEAU_MM = 25.0
_ROUNDS = 15


def mean_bones() -> dict[str, Mesh]:
    """Femur, tibia and patella of the mean man, each in its own frame (mm), before they stand."""
    shape = mean_shape()
    return {
        "femur": mesh_of(mean_femur(shape.femur).outer),
        "tibia": mesh_of(mean_tibia(shape.tibia).outer),
        "patella": mesh_of(patella(build_of(Knee(), shape)).outer),
    }


def stand(points_mm: Array, name: str) -> Array:
    """(n, 3)  places of the mean man's bone as it stands in the knee of default parameters

    points_mm  (n, 3)
    """
    build = build_of(Knee(), mean_shape())
    how = {"femur": stand_femur, "tibia": stand_tibia}.get(name)
    return how(points_mm, build) if how else points_mm


def unstand(places_mm: Array, name: str) -> Array:
    """(n, 3)  the points that `stand` takes to places

    places_mm  (n, 3)
    """
    points = np.array(places_mm, np.float64)
    for _ in range(_ROUNDS):
        points += places_mm - stand(points, name)
    return points


def own_frames(built: Mapping[str, Mesh], people: Mapping[str, MeasuredSurface]) -> dict[str, Frame]:
    """Bone -> what takes places on the mean of people's bones, (n, 3) mm, into the frame of the mean man's.

    Each bone is turned and moved by a similarity fit of its own. One size is taken for all, that of the plateau's
    width, which stays what it was, so that the bones of a knee go on fitting one another as people's do.
    built  as it is before it stands
    """
    standing = {name: Mesh(stand(bone.vertices, name), bone.faces) for name, bone in built.items() if name in people}
    fits = {name: fit_bone(bone, people[name], name).fit for name, bone in standing.items()}
    if "tibia" not in fits:
        return {name: partial(_into, fit=fit, name=name) for name, fit in fits.items()}
    own = fits["tibia"]
    wide = _plateau_width(standing["tibia"]) / _plateau_width(
        Mesh(own.undo(people["tibia"].mesh.vertices), people["tibia"].mesh.faces)
    )
    frames = dict[str, Frame]()
    for name, fit in fits.items():
        sized = _with_scale(fit, own.scale / wide, near_joint(standing[name], name))
        if name == "femur":
            lowest = float(_into(people[name].mesh.vertices, sized, name)[:, 2].min())
            # The femur's frame begins at the distal end.
            lift = Similarity(rotation=np.eye(3), scale=1.0, shift_mm=np.array([0.0, 0.0, -lowest]))
            sized = Similarity(
                rotation=sized.rotation, scale=sized.scale, shift_mm=sized.apply(-lift.shift_mm[None])[0]
            )
        frames[name] = partial(_into, fit=sized, name=name)
    return frames


def in_frame(bone: Mesh, frame: Frame) -> MeasuredSurface:
    """A bone of people, laid onto their mean, in the frame of the mean man's."""
    return measured(Mesh(frame(np.asarray(bone.vertices, np.float64)), bone.faces))


def laid_onto(bone: Mesh, onto: MeasuredSurface, name: str) -> Mesh:
    """A bone laid onto the mean of its kind by a similarity: pose and size taken out."""
    return Mesh(fit_bone(bone, onto, name).fit.apply(bone.vertices), bone.faces)


def _into(places_mm: Array, fit: Similarity, name: str) -> Array:
    return unstand(fit.undo(places_mm), name)


def _plateau_width(tibia: Mesh) -> float:
    top = tibia.vertices[tibia.vertices[:, 2] > tibia.vertices[:, 2].max() - _PLATEAU_MM]
    return float(np.ptp(top[:, 0]))


def _with_scale(fit: Similarity, scale: float, bone: Mesh) -> Similarity:
    """The same fit at another scale, the middle of a bone staying where it is."""
    middle = np.stack((bone.vertices.min(axis=0), bone.vertices.max(axis=0))).mean(axis=0)[None]
    moved = fit.apply(middle)[0] - scale * (middle @ fit.rotation.T)[0]
    return Similarity(rotation=fit.rotation, scale=scale, shift_mm=moved)
