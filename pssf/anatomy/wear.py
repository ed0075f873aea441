"""Wear: where a femur would stand in a tibia the plateau is worn to its form, bone on bone."""

import numpy as np
from manifold3d import Manifold, OpType

from ..core.checks import Array
from .bones import Bone
from .conflicts import NoRoomError

# Between worn bones, which touch in people: half of what a joint space is exact to.
CONTACT_MM = 5e-4
# So deep a plateau or a spine may be worn (OARSI's atlas has no number; judgement): a tall spine with a spike stands
# 6 mm in the wall of a narrow notch, as bones have it whose shape is 3 deviations off in every mode.
MOST_MM = 7.0
# What is shared by so little is rounding.
NOTHING_MM3 = 1e-6
# What comes off a plateau where it is worn thin: smaller bodies are crumbs.
_CRUMB_MM3 = 0.1


def worn(tibia: Bone, femur: Manifold, plate_mm: float) -> Bone:
    """A tibia without what the femur stands in, under a plate as thick as elsewhere; itself where they do not meet.

    tibia, femur  in the knee frame
    plate_mm      thickness of the plate under the worn surface
    raises        InputError where that would be deeper than MOST_MM
    """
    wearing = _wearing(tibia.outer, femur, CONTACT_MM + plate_mm)
    if wearing is None:
        return tibia
    return Bone(
        outer=_without_crumbs(_without(tibia.outer, wearing, CONTACT_MM)),
        inner=_without_crumbs(_without(tibia.inner, wearing, CONTACT_MM + plate_mm)),
        canal=tibia.canal,
    )


def worn_outer(tibia: Manifold, femur: Manifold) -> Manifold:
    """The outer solid alone of a tibia that is worn by a femur, both in one frame; with the crumbs.

    raises  as `worn`
    """
    wearing = _wearing(tibia, femur, CONTACT_MM)
    return tibia if wearing is None else _without(tibia, wearing, CONTACT_MM)


def near(femur: Manifold, box_mm: Array, margin_mm: float) -> Manifold:
    """What of a femur is in a box (2, 3) or as near to it: what is worn has no more to do with the rest."""
    low, high = box_mm[0] - margin_mm, box_mm[1] + margin_mm
    for axis, way in enumerate(np.eye(3)):
        femur = femur.trim_by_plane(tuple(way), low[axis]).trim_by_plane(tuple(-way), -high[axis])
    return femur


def _wearing(tibia: Manifold, femur: Manifold, margin_mm: float) -> Manifold | None:
    """What of a femur is in a tibia or as near to that as a margin; None where they do not meet."""
    shared = tibia ^ femur
    if shared.volume() <= NOTHING_MM3:
        return None
    if (tibia ^ femur.translate((0.0, 0.0, MOST_MM))).volume() > NOTHING_MM3:
        raise NoRoomError(
            f"femur and tibia overlap by {shared.volume():.3g} mm3, in places by more than {MOST_MM:g} mm (joint "
            "spaces, osteophytes and pose leave them no room); allowed: less, which is worn off the plateau"
        )
    return near(femur, np.array(shared.bounding_box()).reshape(2, 3), margin_mm)


def _without(solid: Manifold, femur: Manifold, apart_mm: float) -> Manifold:
    """A solid without a femur and what is so near to it, downwards and to all sides."""
    # The femur itself too: an edge of it may be thinner than the way that its copies go.
    ways = apart_mm * np.array([[0, 0, 0], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return Manifold.batch_boolean([solid, *(femur.translate(way) for way in ways)], OpType.Subtract)


def _without_crumbs(solid: Manifold) -> Manifold:
    bodies = solid.decompose()
    return solid if len(bodies) == 1 else Manifold.compose([one for one in bodies if one.volume() > _CRUMB_MM3])
