"""Both knees of a patient side by side in one scene."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import InputError
from ..geometry.density import Density, TranslatedDensity
from ..geometry.mesh import Mesh
from ..geometry.scene import Scene, Surface
from ..geometry.view import resolve_view
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Truth
from ..model.sampling.acquisition import describe_acquisition
from .built_knee import BuiltKnee, build

SIDES = ("right", "left")


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltPair:
    """Both knees in one scene, with the right knee on the left of the image as on a displayed radiograph.

    Construct it with `build_pair`.

    Attributes
    ----------
    knees : tuple of BuiltKnee
        Right and left knee, each in its own frame.
    scene : Scene
        Surfaces of both knees, named ``"right_femur"`` and so on, in mm.
    knee_distance_mm : float
        Distance between the origins of the two knees, in mm.
    """

    knees: tuple[BuiltKnee, BuiltKnee]
    scene: Scene
    knee_distance_mm: float

    def truths(self, protocol: Protocol) -> tuple[Truth, ...]:
        """Measure labels and landmarks of both knees on one radiograph.

        Parameters
        ----------
        protocol : Protocol
            Acquisition protocol.

        Returns
        -------
        tuple of Truth
            Labels of the right and the left knee, without masks.
        """
        view = resolve_view(protocol)
        right, left = (
            # Shifting source and detector in the opposite direction gives the same projection as shifting the knee.
            replace(
                built.compute_truth_in_view(
                    replace(
                        view, source_mm=_shift_point(view.source_mm, -x), centre_mm=_shift_point(view.centre_mm, -x)
                    )
                ),
                acquisition=describe_acquisition(built.knee, protocol),
            )
            for built, x in zip(self.knees, _compute_origins_x_mm(self.knee_distance_mm), strict=True)
        )
        return right, left

    def mask_meshes(self) -> tuple[dict[str, Mesh], dict[str, Mesh]]:
        """Build the meshes whose silhouettes are the masks.

        Returns
        -------
        right : dict of str to Mesh
            Surface of each bone, osteophyte, cyst site and implant of the right knee in the frame of the scene, in mm.
        left : dict of str to Mesh
            Surface of each bone, osteophyte, cyst site and implant of the left knee in the frame of the scene, in mm.
        """
        right, left = (
            {name: _shift_mesh(mesh, x) for name, mesh in built.mask_meshes().items()}
            for built, x in zip(self.knees, _compute_origins_x_mm(self.knee_distance_mm), strict=True)
        )
        return right, left


def build_pair(right: Knee | BuiltKnee, left: Knee | BuiltKnee, protocol: Protocol) -> BuiltPair:
    """Build both knees of a patient in the posture and at the knee distance of a protocol.

    Parameters
    ----------
    right : Knee or BuiltKnee
        Right knee.
    left : Knee or BuiltKnee
        Left knee.
    protocol : Protocol
        Protocol for both knees, with a horizontal beam and a knee distance above 0.

    Returns
    -------
    BuiltPair
        Both knees in one scene.

    Raises
    ------
    InputError
        If `right` is not a right knee or `left` is not a left knee, or if the legs overlap. Also if the protocol is for
        one knee or aligns its beam with a plateau.
    """
    for knee, side in zip((right, left), SIDES, strict=True):
        if not isinstance(knee, Knee | BuiltKnee) or _unwrap_knee(knee).side != side:
            what = _unwrap_knee(knee).side if isinstance(knee, Knee | BuiltKnee) else type(knee).__name__
            raise InputError(f"knees must be a right and a left Knee in this order, got {what} as the {side} knee")
    if not protocol.knee_distance_mm:
        raise InputError(
            f"knee_distance_mm must be above 0 mm for two knees, got 0 mm: protocol {protocol.name} is for one knee"
        )
    if protocol.beam_along != "horizontal":
        raise InputError(
            f"beam_along must be 'horizontal' for two knees, got {protocol.beam_along!r}: one beam cannot be aligned "
            "with both plateaus"
        )
    built = [knee if isinstance(knee, BuiltKnee) else build(knee, protocol) for knee in (right, left)]
    _require_separation(built, protocol.knee_distance_mm)
    surfaces = [
        surface
        for one, x in zip(built, _compute_origins_x_mm(protocol.knee_distance_mm), strict=True)
        for surface in _shift_surfaces(one, x)
    ]
    return BuiltPair(knees=(built[0], built[1]), scene=Scene(surfaces), knee_distance_mm=protocol.knee_distance_mm)


def _unwrap_knee(knee: Knee | BuiltKnee) -> Knee:
    """Return the parameters of a Knee or of a BuiltKnee."""
    return knee.knee if isinstance(knee, BuiltKnee) else knee


def _compute_origins_x_mm(knee_distance_mm: float) -> tuple[float, float]:
    """Return the x coordinates of the origins of the right and the left knee, in mm."""
    return -knee_distance_mm / 2, knee_distance_mm / 2


def _require_separation(built: list[BuiltKnee], knee_distance_mm: float) -> None:
    """Raise InputError if the legs overlap."""
    needed_mm = float(built[0].scene.bounds_mm[1, 0] - built[1].scene.bounds_mm[0, 0])
    if needed_mm >= knee_distance_mm:
        raise InputError(
            f"knee_distance_mm must be more than {needed_mm:.0f} mm for these legs, got {knee_distance_mm:g} mm: "
            "the legs overlap"
        )


def _shift_surfaces(built: BuiltKnee, x_mm: float) -> list[Surface]:
    """Shift all surfaces of a knee along x, in mm, and prefix their names with the side."""
    known: dict[int, Density] = {}

    def moved(density: Density | None) -> Density | None:
        # If several surfaces use one density object, their shifted copies also use one object, because ray casting
        # integrates these surfaces together.
        return density and known.setdefault(id(density), TranslatedDensity(density=density, offset_mm=(x_mm, 0.0, 0.0)))

    side = built.knee.side
    return [
        Surface(
            _shift_mesh(surface.mesh_arrays, x_mm),
            inside=surface.inside,
            outside=surface.outside,
            name=f"{side}_{surface.name}",
            inside_density=moved(surface.inside_density),
            outside_density=moved(surface.outside_density),
        )
        for surface in built.scene.surfaces
    ]


def _shift_mesh(mesh: Mesh, x_mm: float) -> Mesh:
    """Shift a mesh along x, in mm."""
    return Mesh(mesh.vertices + np.array([x_mm, 0.0, 0.0]), mesh.faces)


def _shift_point(place: tuple[float, float, float], x_mm: float) -> tuple[float, float, float]:
    """Shift a point (3,) along x, in mm."""
    return place[0] + x_mm, place[1], place[2]
