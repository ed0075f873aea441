"""Joint localisation on valid and deliberately faulty simulated radiographs, and derivation of its limits."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...anatomy import build
from ...core.checks import InputError
from ...core.processes.parallel_map import map_in_parallel
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from ...data.anatomy.shape_table import load_shape_model
from ...geometry.scene import Scene
from ...geometry.view import magnification, resolve_view
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...simulation import simulate
from ...standard_templates import make_standard_templates
from ..knees.build_success import sample_wide_range_knee
from ..raycasting.raycast_engines import Row

if TYPE_CHECKING:
    from ...radiomics.localisation.joint_localisation import JointLocation
    from ...radiomics.localisation.templates import Template

# Protocols for the knees that are sampled as in a study.
STUDY_PROTOCOLS = ("reference", "low_dose", "geometry_shift")
# Protocols for every fourth knee, which is sampled from wide adult ranges.
OTHER_PROTOCOLS = ("long_distance", "caudal_beam", "scatter_grid", "high_kv", "gos_screen", "large_focus")
# Number of detector pixels per side.
_SIDE_PX = 512
# Edge length of the region of interest, in pixels.
_REGION_PX = 128
# Names of the surfaces in a scene without bones.
_SOFT_TISSUES = ("skin", "adipose", "muscle")
# Binning of images with unknown pixel pitch, in pixels; patient images with unknown pitch are often reduced crops.
_BINNING_PX = 2


class _LocalisationCase(NamedTuple):
    """Modification of a simulated radiograph, and the expected localisation status.

    Attributes
    ----------
    expected_status : str
        Localisation status that is correct for the modified radiograph.
    pitch_factor : float or None
        Reported pixel pitch divided by the true pitch; None means that neither pixel pitch nor knee side is specified.
    has_bones : bool
        False if the scene contains only soft tissue.
    is_upright : bool
        False if the image is upside down.
    is_mirrored : bool
        True if the localisation receives the opposite knee side (left instead of right, or right instead of left).
    """

    expected_status: str
    pitch_factor: float | None = 1.0
    has_bones: bool = True
    is_upright: bool = True
    is_mirrored: bool = False


_CASES = {
    "right": _LocalisationCase("found"),
    "wrong side": _LocalisationCase("wrong side", is_mirrored=True),
    "upside down": _LocalisationCase("upside down", is_upright=False),
    "without bones": _LocalisationCase("no knee", has_bones=False),
    "pitch x 2": _LocalisationCase("wrong scale", 2.0),
    "pitch x 1.5": _LocalisationCase("wrong scale", 1.5),
    "pitch x 0.5": _LocalisationCase("wrong scale", 0.5),
    "right, no pitch": _LocalisationCase("found", None),
    "upside down, no pitch": _LocalisationCase("upside down", None, is_upright=False),
    "without bones, no pitch": _LocalisationCase("no knee", None, has_bones=False),
}
_MEASURES = (
    *("score", "compartment_score", "mean_score", "side_margin", "side_evidence"),
    *("orientation_margin", "orientation_evidence", "scale", "match_distance_mm"),
)


def measure_localisation(count: int, workers: int) -> list[Row]:
    """Measure how often localisation reports the expected status, and the localisation error.

    Parameters
    ----------
    count : int
        Number of knees. Three quarters of the knees are sampled as in a study, and one quarter from wide adult ranges.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per case and sampling method: number of radiographs, of localised joints and of expected statuses,
        localisation error in mm in the joint plane, and minimum and maximum of each score.
    """
    return [
        _summarise_case(case, kind, [one for one in located if one["case"] == case and one["kind"] == kind])
        for located in [_locate_all_knees(count, workers, len(load_shape_model().modes), load_localisation_settings())]
        for kind in ("study", "adult")
        for case in _CASES
        if any((one["case"], one["kind"]) == (case, kind) for one in located)
    ]


def derive_localisation_limits(count: int, workers: int) -> list[Row]:
    """Derive each localisation limit from simulations and compare it with the limit in use.

    Parameters
    ----------
    count : int
        Number of knees, as in :func:`measure_localisation`.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per limit: value derived from the simulations, rule of the derivation, and limit in use (``in_force``).
    """
    table = load_localisation_settings()
    located, limits = _locate_all_knees(count, workers, len(load_shape_model().modes), table), table.thresholds

    def values(case: str, measure: str, kinds: tuple[str, ...] = ("study", "adult")) -> NDArray[np.float64]:
        return np.array([one[measure] for one in located if one["case"] == case and one["kind"] in kinds])

    right, enlarged = values("right", "scale", ("study",)), values("pitch x 1.5", "scale", ("study",))
    rules = [
        ("min_score", values("without bones", "mean_score").max(), limits.min_score, "maximum without bones"),
        ("min_score_unknown_pitch", np.quantile(values("without bones, no pitch", "mean_score"), 0.99),
         limits.min_score_unknown_pitch, "99th percentile without bones and without known pixel pitch"),
        ("min_side_evidence_unknown_pitch",
         np.quantile(np.abs(values("without bones, no pitch", "side_evidence")), 0.99),
         limits.min_side_evidence_unknown_pitch, "99th percentile without bones and without known pixel pitch"),
        ("min_score_square_pixels", values("without bones, no pitch", "mean_score").max(),
         limits.min_score_square_pixels, "above the maximum without bones"),
        ("min_score_stop_search", values("right, no pitch", "mean_score").min(), limits.min_score_stop_search,
         "close to the minimum of valid radiographs without known pixel pitch"),
        ("max_opposite_side_evidence", -np.quantile(values("wrong side", "side_evidence"), 0.99),
         limits.max_opposite_side_evidence, "99th percentile for the wrong side, negated"),
        ("max_upside_down_evidence", np.abs(values("without bones", "orientation_evidence")).max(),
         limits.max_upside_down_evidence, "maximum without bones"),
        ("max_match_distance_mm",
         sum(values(case, "match_distance_mm").max() for case in ("right", "without bones")) / 2,
         limits.max_match_distance_mm, "mean of the maxima of valid radiographs and without bones"),
        ("scale, least", np.sqrt(values("right", "scale").min() * values("pitch x 0.5", "scale").max()),
         limits.accepted_scale_range[0],
         "geometric mean of the minimum of valid radiographs and the maximum at half the pixel pitch"),
        ("scale, greatest", np.sqrt(right.max() * np.quantile(enlarged, 0.01)), limits.accepted_scale_range[1],
         "geometric mean of the maximum of valid radiographs and the 1st percentile at 1.5 times the pixel pitch"),
    ]  # fmt: skip
    return [
        {"limit": name, "simulations": round(float(value), 3), "in_force": in_force, "rule": rule, "knees": count}
        for name, value, in_force, rule in rules
    ]


def _summarise_case(case: str, kind: str, located: list[Row]) -> Row:
    """Summarise the localisation results of one case and one sampling method of knees."""
    meant, is_right = _CASES[case].expected_status, case.startswith("right")
    errors = np.array([one["error_mm"] for one in located if one["status"] == "found"])
    row: Row = {
        "case": case, "knees_of": kind, "radiographs": len(located),
        "found": sum(one["status"] == "found" for one in located),
        "as_meant": sum(one["status"] == meant for one in located), "meant": meant,
        "mean_error_mm": round(float(errors.mean()), 2) if is_right and len(errors) else "",
        "p95_error_mm": round(float(np.quantile(errors, 0.95)), 2) if is_right and len(errors) else "",
    }  # fmt: skip
    for name in _MEASURES:
        values = [one[name] for one in located]
        row |= {f"least_{name}": round(min(values), 3), f"most_{name}": round(max(values), 3)}
    return row


@lru_cache(maxsize=1)  # Tables `localisation` and `localisation_limits` use the same simulations.
def _locate_all_knees(count: int, workers: int, modes: int, table: LocalisationSettings) -> list[Row]:
    """Locate the joint of every knee in every case."""
    shared = {"templates": make_standard_templates("scanline", workers=workers), "modes": modes, "table": table}
    return [
        row
        for rows in map_in_parallel(_locate_knee_in_all_cases, list(range(count)), shared=shared, workers=workers)
        for row in rows
    ]


def _locate_knee_in_all_cases(
    number: int, *, templates: "tuple[Template, ...]", modes: int, table: LocalisationSettings
) -> list[Row]:
    """Locate the joint of one knee in every case; return an empty list if the knee cannot be built."""
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    kind = "adult" if number % 4 == 3 else "study"
    knee = (
        sample_wide_range_knee(rng, modes)
        if kind == "adult"
        else sample_knee(grade=number % 3, rng=rng, grade_table="paper")
    )
    names = OTHER_PROTOCOLS if kind == "adult" else STUDY_PROTOCOLS
    protocol = make_coarse_protocol(load_protocol(names[(number // 4 + number) % len(names)]))
    try:
        built = build(knee)
    except InputError:
        return []
    whole = simulate(built, protocol, rng=number, engine="scanline", workers=1)
    soft = Scene([surface for surface in built.scene.surfaces if surface.name in _SOFT_TISSUES])
    bare = simulate(soft, protocol, rng=number, engine="scanline", workers=1)
    assert whole.truth is not None
    rows = []
    for case in _CASES:
        pixels = whole.pixels if _CASES[case].has_bones else bare.pixels
        joint = _locate_joint(_CASES[case], pixels, knee, protocol, templates, table)
        away = np.subtract((joint.row, joint.col), whole.truth.medial_joint_line_px)
        error_mm = float(np.hypot(*away)) * protocol.pixel_mm / magnification(resolve_view(protocol))
        measures = {name: getattr(joint, name) for name in _MEASURES}
        rows.append({"case": case, "kind": kind, "status": joint.status, "error_mm": error_mm, **measures})
    return rows


def _locate_joint(
    case: _LocalisationCase,
    pixels: NDArray[np.uint16],
    knee: Knee,
    protocol: Protocol,
    templates: "tuple[Template, ...]",
    table: LocalisationSettings,
) -> "JointLocation":
    """Modify an image as the case specifies and locate the joint, in pixels of the modified image."""
    from ...radiomics.localisation.joint_localisation import locate_joint_in_radiograph
    from ...radiomics.localisation.pixel_aspect import locate_joint_in_film
    from ...radiomics.localisation.templates import compute_density

    pixels = pixels if case.is_upright else pixels[::-1]
    if case.pitch_factor is None:
        joint = locate_joint_in_film(compute_density(downsample_by_blocks(pixels, _BINNING_PX)), templates, table)
        row, col = (at * _BINNING_PX + (_BINNING_PX - 1) / 2 for at in (joint.row, joint.col))
        return dataclasses.replace(joint, row=row, col=col)
    side = {"right": "left", "left": "right"}[knee.side] if case.is_mirrored else knee.side
    pixel_mm = protocol.pixel_mm * case.pitch_factor
    return locate_joint_in_radiograph(pixels, templates, table, side=side, pixel_mm=pixel_mm, region_px=_REGION_PX)


def make_coarse_protocol(protocol: Protocol) -> Protocol:
    """Reduce a protocol to 512 x 512 pixels over the same field width.

    Parameters
    ----------
    protocol : Protocol
        Protocol to reduce.

    Returns
    -------
    Protocol
        Protocol with fewer, larger pixels.
    """
    pixel_mm = protocol.pixel_mm * protocol.cols / _SIDE_PX
    return dataclasses.replace(protocol, rows=_SIDE_PX, cols=_SIDE_PX, pixel_mm=pixel_mm)
