"""Radiograph: pixels, what is known about them, and what they were made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from .knee import Knee
from .protocol import Protocol


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Labels that are true by construction. Landmarks are (row, column) on this radiograph, in pixels.

    jsw_medial_mm, jsw_lateral_mm
                       minimum joint space of this radiograph, measured on its projected contours as `Knee.jsw_as`
                       defines it and scaled to the joint plane; negative where the contours overlap, None where the
                       view does not show it (lateral, axial). The specified joint space is `Knee.jsw_medial_mm`
    jsw_at_mm          joint space of this radiograph at fractions of the femur's width from its medial epicondyle
                       (JSW(x))
    landmarks_px       name -> (row, column): joint_centre; medial_ and lateral_ joint_line; medial_ and lateral_
    jsw_femur
                       and jsw_tibia, the ends of the minimum joint space; where bones are widest,
                       osteophytes aside: medial_ and lateral_ condyle_edge, epicondyle, plateau_edge; and the sixteen
                       contour landmarks of `anatomy.landmarks`, osteophytes and all (notch is notch_top). Seen from the
                       side or along the leg none of these is told, nor jsw_at_mm, but places that have a place in every
                       view, as `anatomy.turned_truth` lists them
    attrition_mm       medial and lateral -> greatest depth worn off the plateau in the posture that joint spaces are
                       defined under, whatever this radiograph's; 0 where bones do not meet
    grade              KL grade that the knee was sampled for, or the one derived from its anatomy; grade_read the one
                       that a reader gives, where one is sampled
    readings           OARSI grades by the names of the Osteoarthritis Initiative (`model.oarsi`), angles and
                       ratios (`model.axes`); seen from the front also inter_margin_mm, how far the front margin of the
                       medial plateau is above its back one on this radiograph, scaled to the joint plane
    taking             how it was taken (`model.exposure.taking_of`): pose, beam, dose, field, marker
    masks              if asked for: name -> (rows, cols) bool, where a bone or an osteophyte is seen
    """

    jsw_medial_mm: float | None
    jsw_lateral_mm: float | None
    landmarks_px: Mapping[str, tuple[float, float]]
    grade: int | None = None
    jsw_at_mm: Mapping[float, float] = field(default_factory=dict)
    attrition_mm: Mapping[str, float] = field(default_factory=dict)
    grade_read: int | None = None
    readings: Mapping[str, float] = field(default_factory=dict)
    taking: Mapping[str, float | str] = field(default_factory=dict)
    masks: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def medial_joint_line_px(self) -> tuple[float, float]:
        """Middle of the medial joint space, half way across the compartment (row, column); seen from the front."""
        return self._seen("medial_joint_line")

    @property
    def lateral_joint_line_px(self) -> tuple[float, float]:
        """Middle of the lateral joint space, half way across the compartment (row, column); seen from the front."""
        return self._seen("lateral_joint_line")

    def _seen(self, name: str) -> tuple[float, float]:
        if name not in self.landmarks_px:
            known = ", ".join(self.landmarks_px)
            raise InputError(f"landmark = {name!r}, which this view does not show; allowed: {known}")
        return self.landmarks_px[name]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Radiograph:
    """One exposure. Two are equal if their pixels are, and all that they were made from; what was kept aside.

    pixels    (rows, cols) uint16, linear in the energy absorbed ("for processing"), row 0 proximal, or axially in front
    knee      its parameters, or None for a scene of one's own, or for two knees
    truth     labels, or None likewise
    knees     right and left, where both were taken together; else none
    truths    labels of either, likewise
    scene     of a scene of one's own its materials and a hash of each mesh; else None
    surgery   what was put into the knee or taken out of it, in order: step, name, material, size and hash of the mesh;
              of two knees the name begins with the side. The meshes themselves are the user's to keep
    engine    that cast its rays
    audit     what it found and mended; see `raycast.Audit`
    versions  of the package and of what the pixels depend on
    kept      what `simulate(keep=...)` asked for; maps (rows, cols) float32; with "scatter" of monte_carlo also
              "scatter_error", its statistical error relative to its mean
    seconds   wall time a stage
    """

    pixels: NDArray[np.uint16] = field(repr=False)
    protocol: Protocol
    seed: int
    knee: Knee | None = None
    truth: Truth | None = None
    knees: tuple[Knee, ...] = ()
    truths: tuple[Truth, ...] = ()
    scene: Mapping[str, Any] | None = None
    surgery: tuple[Mapping[str, Any], ...] = ()
    engine: str = "embree"
    audit: Mapping[str, int] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    kept: Mapping[str, Any] = field(default_factory=dict, repr=False)
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Radiograph):
            return NotImplemented
        names = ("protocol", "seed", "knee", "truth", "knees", "truths", "scene", "surgery", "engine", "versions")
        same = all(getattr(self, name) == getattr(other, name) for name in names)
        return same and np.array_equal(self.pixels, other.pixels)

    def __hash__(self) -> int:
        return hash((self.protocol, self.seed, self.knee, self.knees))

    @property
    def exposure_index(self) -> float:
        """Exposure index by IEC 62494-1: 100 times the air kerma in uGy that an RQA5 beam needs for the same signal.

        The signal is the median of the pixels behind the limb. Calibration is exact by construction: an RQA5 beam,
        70 kV behind 23.5 mm of aluminium, of K uGy at the detector gives 100 K.
        """
        return float(_later("quality.exposure", "exposure_index_of")(self))

    @property
    def entrance_air_kerma_ugy(self) -> float:
        """Air kerma where the beam enters the limb, in uGy, without backscatter and without the limb."""
        return float(_later("quality.exposure", "entrance_kerma_of")(self))

    def show(self) -> None:
        """Show the radiograph, as processed for display, in the system's viewer of pictures."""
        _later("io.pictures", "preview")(self).show()

    def _repr_png_(self) -> bytes:
        """Give a PNG of the radiograph, as processed for display, which notebooks show."""
        return bytes(_later("io.pictures", "preview_png")(self))

    def __repr__(self) -> str:
        protocol, (rows, cols) = self.protocol, self.pixels.shape
        knees = (self.knee,) if self.knee else self.knees
        of = " and ".join(f"{knee.side} knee" for knee in knees) or "a scene"
        grades = [f"grade {knee.grade}" for knee in knees if knee.grade is not None]
        steps = [str(step["name"]) for step in self.surgery]
        taken = f"{protocol.name}, {protocol.tube_kv:g} kV, {protocol.mas:g} mAs"
        size = f"{rows} x {cols} px of {protocol.pixel_mm:g} mm"
        return f"Radiograph({', '.join([of, *grades, *steps, taken, size, f'seed {self.seed}'])})"


def _later(module: str, name: str) -> Any:
    """A function that reads radiographs, of a module to the right of this one; loaded when it is first asked for."""
    return getattr(import_module(f"..{module}", __package__), name)
