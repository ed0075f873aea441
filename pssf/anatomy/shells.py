"""Shells within their hosts, bones clear of each other: path lengths would else be wrong in silence."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from manifold3d import Manifold, OpType

from ..geometry.within import lies_within
from .bones import Bone
from .conflicts import NoRoomError
from .solids import box_about, mesh_of

# Trabecular bone that is outside its cortex by no more than this is drawn in by so much, so far about what is outside.
_MENDED_MM3, _DRAWN_IN_MM, _ABOUT_MM = 10.0, 0.1, 0.5
# So little outside of a host, or shared by two bones, is rounding.
_NOTHING_MM3 = 1e-6


def is_nested(part: Bone) -> bool:
    """Whether the trabecular bone of a bone lies within it, as it nearly always does."""
    # A solid of what is outside takes several times as long.
    return lies_within(mesh_of(part.inner), mesh_of(part.outer))


def drawn_in(name: str, part: Bone) -> Bone:
    """A bone whose trabecular bone lies within it, drawn in where a thin cortex folds.

    raises  InputError where so much lies outside that it is no fold
    """
    outside = part.inner - part.outer
    outside_mm3 = outside.volume()
    if outside_mm3 <= _NOTHING_MM3:
        return part
    if outside_mm3 > _MENDED_MM3:
        raise NoRoomError(f"{name}: its trabecular bone leaves its host by {outside_mm3:.3g} mm3; allowed: 0")
    # Copies of the whole bone would cross each other everywhere, which takes a second.
    pieces = outside.decompose()
    about = part.outer ^ _boxes(pieces, _ABOUT_MM + 2 * _DRAWN_IN_MM)
    ways = [about.translate(tuple(way)) for way in _DRAWN_IN_MM * np.vstack((np.eye(3), -np.eye(3)))]
    smaller = Manifold.batch_boolean([about, *ways], OpType.Intersect)
    return replace(part, inner=part.inner - (_boxes(pieces, _ABOUT_MM) - smaller))


def _boxes(pieces: list[Manifold], margin_mm: float) -> Manifold:
    """All that lies in a box about any of the pieces."""
    return Manifold.batch_boolean([box_about(piece, margin_mm) for piece in pieces], OpType.Add)


def check_nesting(placed: Mapping[str, Bone], muscle: Manifold) -> None:
    """Refuse shells that leave their host and bones that meet.

    raises  InputError naming the bone or bones and the volume
    """
    for name, part in placed.items():
        shells = [("cortex", part.outer, muscle)]
        shells += [("marrow", part.canal, part.inner)] if part.canal is not None else []
        for what, inside, host in shells:
            if lies_within(mesh_of(inside), mesh_of(host)):
                continue
            outside_mm3 = (inside - host).volume()
            if outside_mm3 > _NOTHING_MM3:
                raise NoRoomError(f"{name}: its {what} leaves its host by {outside_mm3:.3g} mm3; allowed: 0")
    names = list(placed)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            shared = (placed[one].outer ^ placed[other].outer).volume()
            if shared > _NOTHING_MM3:
                why = "joint spaces, osteophytes and pose leave them no room"
                raise NoRoomError(f"{one} and {other} overlap by {shared:.3g} mm3 ({why}); allowed: 0 mm3")
