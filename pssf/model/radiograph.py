"""Define `Radiograph` and `Truth`: the pixels, labels and all parameters of a simulated radiograph."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from ..core.keyword_arguments import renamed_attribute
from .knee import Knee
from .protocol import Protocol


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Labels of a radiograph, exact by construction; landmarks are (row, column) in pixels of the radiograph.

    Attributes
    ----------
    jsw_medial_mm : float or None
        Minimum medial joint space width (JSW) on the radiograph, in mm. The JSW is measured between the projected
        contours according to `Knee.jsw_definition`, and scaled to the joint plane. It is negative if the contours
        overlap, and None in a lateral or axial view. `Knee.jsw_medial_mm` is the specified JSW, which may differ.
    jsw_lateral_mm : float or None
        Minimum lateral JSW on the radiograph, in mm, defined as for the medial compartment.
    landmarks_px : mapping of str to (row, column) pair of float
        Landmark positions keyed by landmark name; see Notes.
    grade : int or None
        `Knee.grade`, or the KL grade derived from the anatomy if `Knee.grade` is None.
    jsw_at_mm : mapping of float to float
        Joint space width JSW(x) in mm, keyed by the location x. The location is the distance from the medial epicondyle
        as a fraction of the width of the femur. Empty in a lateral or axial view.
    attrition_mm : mapping of str to float
        Greatest attrition depth of the medial and lateral plateau, in mm; 0 if the bones do not touch. The depth is
        computed in the posture of the JSW definition, so it does not depend on the posture of the radiograph.
    reader_grade : int or None
        KL grade assigned by a simulated reader; None if no reader is simulated.
    readings : mapping of str to float
        OARSI grades with the variable names of the Osteoarthritis Initiative (`model.oarsi_grades`), and limb angles
        and length ratios (`model.limb_axes`). A frontal view also has ``inter_margin_mm``: the height of the front
        margin of the medial plateau above its back margin on the radiograph, scaled to the joint plane.
    acquisition : mapping of str to (float or str)
        Leg pose, beam, dose, collimated field and side marker of the radiograph
        (`model.sampling.acquisition.describe_acquisition`).
    masks : mapping of str to (rows, cols) bool array
        Masks of the bones, osteophytes, cysts and implants, keyed by name. Empty unless `simulate` is called with a
        request for masks.

    Notes
    -----
    In a frontal view, `landmarks_px` has three groups of landmarks. In the landmark names, ``*`` represents ``medial``
    or ``lateral``. The first group describes the joint space: ``joint_centre``, ``*_joint_line``, ``*_jsw_femur`` and
    ``*_jsw_tibia``. ``*_jsw_femur`` and ``*_jsw_tibia`` are the ends of the minimum joint space. The second group
    contains the widest points of the bones without osteophytes: ``*_condyle_edge``, ``*_epicondyle`` and
    ``*_plateau_edge``. The third group contains the sixteen contour landmarks of `anatomy.outlines.contour_landmarks`,
    which include osteophytes; ``notch`` is the same as ``notch_top``. `anatomy.labels.lateral_axial_labels` lists the
    landmarks of lateral and axial views.

    Examples
    --------
    >>> import pssf
    >>> truth = pssf.Truth(jsw_medial_mm=4.8, jsw_lateral_mm=5.1, landmarks_px={"medial_joint_line": (1020.0, 880.5)})
    >>> truth.medial_joint_line_px
    (1020.0, 880.5)
    """

    jsw_medial_mm: float | None
    jsw_lateral_mm: float | None
    landmarks_px: Mapping[str, tuple[float, float]]
    grade: int | None = None
    jsw_at_mm: Mapping[float, float] = field(default_factory=dict)
    attrition_mm: Mapping[str, float] = field(default_factory=dict)
    reader_grade: int | None = None
    readings: Mapping[str, float] = field(default_factory=dict)
    acquisition: Mapping[str, float | str] = field(default_factory=dict)
    masks: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict, compare=False, repr=False)

    # Deprecated names, available for one more version.
    taking = renamed_attribute("acquisition")
    grade_read = renamed_attribute("reader_grade")

    @property
    def medial_joint_line_px(self) -> tuple[float, float]:
        """Centre of the medial joint space at half the compartment width: (row, column) in pixels; frontal only."""
        return self._require_landmark("medial_joint_line")

    @property
    def lateral_joint_line_px(self) -> tuple[float, float]:
        """Centre of the lateral joint space at half the compartment width: (row, column) in pixels; frontal only."""
        return self._require_landmark("lateral_joint_line")

    def _require_landmark(self, name: str) -> tuple[float, float]:
        """Return (row, column) of a landmark; raise InputError if the view does not show the landmark."""
        if name not in self.landmarks_px:
            known = ", ".join(self.landmarks_px)
            raise InputError(f"landmark must be one of {known} in this view, got {name!r}")
        return self.landmarks_px[name]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Radiograph:
    """Simulated radiograph: pixels, labels, and all parameters of the simulation.

    Attributes
    ----------
    pixels : (rows, cols) uint16 array
        Pixel values, linear in the absorbed energy ("for processing"). Row 0 is proximal; in an axial view it is
        anterior.
    protocol : Protocol
        Protocol of the exposure.
    seed : int
        Seed of the noise.
    knee : Knee or None
        Parameters of the knee; None for two knees or a user-defined scene.
    truth : Truth or None
        Labels; None for two knees or a user-defined scene.
    knees : tuple of Knee
        Right and left knee of a bilateral radiograph, else empty.
    truths : tuple of Truth
        Labels of the right and left knee of a bilateral radiograph, else empty.
    scene : mapping or None
        Material and hash of every mesh in a user-defined scene; None for knees.
    surgery : tuple of mapping
        Implants and resections in surgical order, each with step, name, material, size and mesh hash. For two knees,
        the name begins with "right" or "left". The meshes are not stored.
    engine : {"embree", "scanline"}
        Ray caster that computed the path lengths.
    audit : mapping of str to int
        Numbers of rays that were cast and recomputed (`raycast.path_lengths.Audit`).
    versions : mapping of str to str
        Versions of the package and of the libraries that affect the pixels.
    kept : mapping of str to (rows, cols) float32 array
        Intermediate maps requested by ``simulate(keep=...)``. "path_mm" contains one map per material. Monte Carlo
        "scatter" is accompanied by "scatter_error": the statistical error of the scatter relative to its mean.
    seconds : mapping of str to float
        Run time of each simulation stage, in s.

    Notes
    -----
    Two radiographs are equal if their pixels and all parameters of the simulation are equal; `kept`, `audit` and
    `seconds` are not compared.

    Examples
    --------
    >>> import pssf
    >>> small = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(pssf.Knee(), small, rng=7, engine="scanline")
    >>> radiograph
    Radiograph(right knee, reference, 70 kV, 2 mAs, 64 x 64 px of 4.8 mm, seed 7)
    >>> round(radiograph.truth.jsw_medial_mm, 1)
    5.0
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
        """Exposure index (IEC 62494-1): 100 times the air kerma, in uGy, of an RQA5 beam that gives the same signal.

        The signal is the median of the pixels behind the limb. By definition, an RQA5 beam (70 kV, 23.5 mm of
        aluminium) with a detector air kerma of K uGy has the exposure index 100 K.
        """
        return float(_load_function("quality.exposure_index", "compute_exposure_index")(self))

    @property
    def entrance_air_kerma_ugy(self) -> float:
        """Incident air kerma at the entrance surface of the limb, in uGy, without backscatter."""
        return float(_load_function("quality.exposure_index", "compute_entrance_kerma_ugy")(self))

    def show(self) -> None:
        """Apply display processing, and open the radiograph in the default image viewer of the system."""
        _load_function("io.pictures", "make_preview")(self).show()

    def _repr_png_(self) -> bytes:
        """Apply display processing, and encode the radiograph as PNG for notebooks."""
        return bytes(_load_function("io.pictures", "encode_preview_png")(self))

    def __repr__(self) -> str:
        protocol, (rows, cols) = self.protocol, self.pixels.shape
        knees = (self.knee,) if self.knee else self.knees
        of = " and ".join(f"{knee.side} knee" for knee in knees) or "a scene"
        grades = [f"grade {knee.grade}" for knee in knees if knee.grade is not None]
        steps = [str(step["name"]) for step in self.surgery]
        taken = f"{protocol.name}, {protocol.tube_kv:g} kV, {protocol.mas:g} mAs"
        size = f"{rows} x {cols} px of {protocol.pixel_mm:g} mm"
        return f"Radiograph({', '.join([of, *grades, *steps, taken, size, f'seed {self.seed}'])})"


def _load_function(module: str, name: str) -> Any:
    """Import a function at its first use, because an import at the top of this module would be circular."""
    return getattr(import_module(f"..{module}", __package__), name)
