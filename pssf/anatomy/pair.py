"""BuiltPair: both knees of a person beside each other, before one detector."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import InputError
from ..geometry.density import Density, Moved
from ..geometry.mesh import Mesh
from ..geometry.scene import Scene, Surface
from ..geometry.view import view_of
from ..model.exposure import taking_of
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Truth
from .built import BuiltKnee, build

SIDES = ("right", "left")


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltPair:
    """Both knees as one scene; the right one on the film's left, as it is hung.

    knees     right and left, each in its own frame
    scene     of both, surfaces named "right_femur" and so on
    apart_mm  from the origin of one to that of the other
    """

    knees: tuple[BuiltKnee, BuiltKnee]
    scene: Scene
    apart_mm: float

    def truths(self, protocol: Protocol) -> tuple[Truth, ...]:
        """Labels and landmarks of right and left on the radiograph of both; without masks."""
        view = view_of(protocol)
        right, left = (
            # A knee beside the middle is seen as one in the middle by a source and a detector beside it.
            replace(
                built.truth_in(
                    replace(view, source_mm=_moved(view.source_mm, -x), centre_mm=_moved(view.centre_mm, -x))
                ),
                taking=taking_of(built.knee, protocol),
            )
            for built, x in zip(self.knees, _places(self.apart_mm), strict=True)
        )
        return right, left

    def solids(self) -> tuple[dict[str, Mesh], dict[str, Mesh]]:
        """Of right and left: name -> mesh, mm, of each bone and each osteophyte, where the scene has it."""
        right, left = (
            {name: _beside(mesh, x) for name, mesh in built.solids().items()}
            for built, x in zip(self.knees, _places(self.apart_mm), strict=True)
        )
        return right, left


def build_pair(right: Knee | BuiltKnee, left: Knee | BuiltKnee, protocol: Protocol) -> BuiltPair:
    """Both knees of a person in the posture of a protocol, as far apart as it says.

    raises  InputError for knees that are not right and left, a protocol for one knee, a beam fitted to one, legs that
            overlap
    """
    for knee, side in zip((right, left), SIDES, strict=True):
        if not isinstance(knee, Knee | BuiltKnee) or _knee(knee).side != side:
            what = _knee(knee).side if isinstance(knee, Knee | BuiltKnee) else type(knee).__name__
            raise InputError(f"knees: {side} one = {what}; allowed: a right and a left Knee, in this order")
    if not protocol.apart_mm:
        raise InputError(f"apart_mm = 0 mm with two knees, under {protocol.name}; allowed: as far as they are apart")
    if protocol.beam_along != "horizontal":
        raise InputError(
            f"beam_along = {protocol.beam_along!r} with two knees; allowed: 'horizontal', since one beam cannot be "
            "fitted to both"
        )
    built = [knee if isinstance(knee, BuiltKnee) else build(knee, protocol) for knee in (right, left)]
    _require_room(built, protocol.apart_mm)
    surfaces = [
        surface for one, x in zip(built, _places(protocol.apart_mm), strict=True) for surface in _surfaces(one, x)
    ]
    return BuiltPair(knees=(built[0], built[1]), scene=Scene(surfaces), apart_mm=protocol.apart_mm)


def _knee(knee: Knee | BuiltKnee) -> Knee:
    return knee.knee if isinstance(knee, BuiltKnee) else knee


def _places(apart_mm: float) -> tuple[float, float]:
    """x of the origins of right and left."""
    return -apart_mm / 2, apart_mm / 2


def _require_room(built: list[BuiltKnee], apart_mm: float) -> None:
    needed_mm = float(built[0].scene.bounds_mm[1, 0] - built[1].scene.bounds_mm[0, 0])
    if needed_mm >= apart_mm:
        raise InputError(
            f"apart_mm = {apart_mm:g} mm: the legs overlap; allowed: more than {needed_mm:.0f} mm for these"
        )


def _surfaces(built: BuiltKnee, x_mm: float) -> list[Surface]:
    known: dict[int, Density] = {}

    def moved(density: Density | None) -> Density | None:
        # Surfaces that share a density share it still: an engine takes them together.
        return density and known.setdefault(id(density), Moved(density=density, by_mm=(x_mm, 0.0, 0.0)))

    side = built.knee.side
    return [
        Surface(
            _beside(surface.arrays, x_mm),
            inside=surface.inside,
            outside=surface.outside,
            name=f"{side}_{surface.name}",
            inside_density=moved(surface.inside_density),
            outside_density=moved(surface.outside_density),
        )
        for surface in built.scene.surfaces
    ]


def _beside(mesh: Mesh, x_mm: float) -> Mesh:
    return Mesh(mesh.vertices + np.array([x_mm, 0.0, 0.0]), mesh.faces)


def _moved(place: tuple[float, float, float], x_mm: float) -> tuple[float, float, float]:
    return place[0] + x_mm, place[1], place[2]
