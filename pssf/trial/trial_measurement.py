"""Measurement of the radiographs of a subject: true joint space, readers, alignment and texture."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import structs

from ..anatomy import BuiltKnee, build
from ..core.checks import InputError
from ..core.random_streams import make_stream
from ..data.analysis.trial_table import TrialDesign
from ..data.imaging.display_table import DisplayProcessing, FlatPanelProcessing
from ..data.knees.oarsi_table import OarsiThresholds
from ..detector.display_rendering import render_for_display
from ..image_faults import ImageNotice
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Radiograph, Truth
from ..model.sampling.display_sampling import sample_processing_from_table
from ..model.sampling.knee_sampling import KneeDistributions
from ..raycast.detector_clearance import move_clear_of_detector
from ..reader.knee_reading import Reader, load_reader, read_knees
from ..simulation import KernelNotice, simulate
from ..texture import (
    UnmeasurableTextureError,
    make_texture_region,
    measure_texture_features,
    mirror_texture_features,
)
from .image_appearance import measure_appearance
from .minimal_distance import measure_minimal_distances
from .trial_plan import PlannedRadiograph, plan_radiographs, plan_subject

# Fraction of the femoral width at which the fixed joint space is measured (Neumann et al. 2009).
FIXED_AT = 0.225
# Fractions whose mean is the mean medial joint space, which is proportional to the joint space area.
_AREA_AT = (0.15, 0.175, 0.2, 0.225, 0.25, 0.275, 0.3)
# Measures of every reader: minimum joint spaces, JSW(x), mean medial joint space, and OARSI grade of narrowing.
_SPACES = ("medial_mm", "lateral_mm", "fixed_mm", "mean_mm")
MEASURES = (*_SPACES, "narrowing")
TEXTURES = ("vot_MeanDimension", "fsa_HorizontalDimension", "fsa_VerticalDimension")
_TEXTURE_REGION = "medial_subchondral"
# Stream of the display processing of a site.
_DISPLAY = 100
# Number of attempts to sample a subject whose knees can be built.
_ATTEMPTS = 5
Row = dict[str, Any]


def measure_subject(
    number: int,
    *,
    design: TrialDesign,
    views: Mapping[str, Protocol],
    distributions: KneeDistributions,
    displays: Mapping[str, str | FlatPanelProcessing],
    cuts: OarsiThresholds,
    without: str,
) -> list[Row]:
    """Simulate and measure the radiographs of a subject.

    Parameters
    ----------
    number : int
        Number of the subject.
    design : TrialDesign
        Design of the trial.
    views : mapping of str to Protocol
        Nominal protocol of each view.
    distributions : KneeDistributions
        Distributions of the grade table.
    displays : mapping of str to (str or FlatPanelProcessing)
        Display processing of each site, from `resolve_displays`.
    cuts : OarsiThresholds
        Thresholds of the OARSI grades.
    without : str
        Cause of error that is left out; empty: none.

    Returns
    -------
    list of dict
        One row per radiograph. Lengths are in mm, at the nominal magnification of the view.

    Raises
    ------
    InputError
        If no attempt gives knees that can be built.
    """
    for attempt in range(_ATTEMPTS):
        try:
            # Another seed gives another subject; the attempt of almost all subjects is 0.
            tried = _replace_seed(design, attempt)
            subject = plan_subject(tried, distributions, number)
            planned = plan_radiographs(tried, views, subject, without=without)
            return [
                {**one.labels, "attempt": attempt, **measured}
                for one, measured in zip(
                    planned,
                    _measure_in_turn(planned, tried, views, displays[subject.site.name], cuts),
                    strict=True,
                )
            ]
        except InputError:
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def _replace_seed(design: TrialDesign, attempt: int) -> TrialDesign:
    """Return a design with the seed of another attempt; attempt 0 returns the design itself."""
    if not attempt:
        return design
    return structs.replace(design, seed=int(make_stream(design.seed, _DISPLAY + attempt).integers(2**63)))


def resolve_displays(design: TrialDesign, table: DisplayProcessing) -> dict[str, str | FlatPanelProcessing]:
    """Resolve the display processing of each site; a sampled one is the same for all images of the site.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    table : DisplayProcessing
        Distributions of display processing.

    Returns
    -------
    dict of str to (str or FlatPanelProcessing)
        Processing by name of the site.
    """
    return {
        site.name: sample_processing_from_table(table, rng=make_stream(design.seed, _DISPLAY, place))
        if site.display == "sampled"
        else site.display
        for place, site in enumerate(design.sites)
    }


def _measure_in_turn(
    planned: Sequence[PlannedRadiograph],
    design: TrialDesign,
    views: Mapping[str, Protocol],
    display: str | FlatPanelProcessing,
    cuts: OarsiThresholds,
) -> list[Row]:
    """Measure planned radiographs; neighbours with the same knee and pose share the built knee."""
    rows, last = list[Row](), None
    reader = load_reader() if "network" in design.readers else None
    built: BuiltKnee | None = None
    for one in planned:
        pose = (one.knee, one.protocol.posture)
        if built is None or pose != last:
            built, last = build(one.knee, one.protocol), pose
        protocol = move_clear_of_detector(built.scene, built.aim_beam(one.protocol))
        truth = built.truth(protocol)
        nominal = views[one.labels["view"]]
        magnification = (protocol.sdd_mm / protocol.sod_mm) / (nominal.sdd_mm / nominal.sod_mm)
        exact = _read_labels(truth, magnification)
        row = (
            _describe(one.knee, truth, protocol)
            | _measure_distances(built, one.labels)
            | _name_measures("label", exact, one.knee, cuts)
        )
        if "human" in design.readers:
            row |= _name_measures("human", _read_as_human(exact, design, one.reading_key), one.knee, cuts)
        if reader is not None or design.texture:
            radiograph = _simulate(built, protocol, one.noise_seed)
            processing = "processed" if one.labels["without"] == "display" else display
            shown = render_for_display(radiograph, bits=16, processing=processing)
            row |= measure_appearance(np.asarray(shown), truth.landmarks_px["joint_centre"], protocol.pixel_mm)
            if reader is not None:
                read = _read_by_network(shown, nominal, one.knee.side, reader)
                row |= _name_measures("network", read, one.knee, cuts)
            if design.texture:
                row |= _measure_texture(radiograph, one.knee.side, shown)
        rows.append(row)
    return rows


def _describe(knee: Knee, truth: Truth, protocol: Protocol) -> Row:
    """Describe knee and alignment: true joint spaces, and height of the plateau margins on the radiograph."""
    return {
        "true_medial_mm": knee.jsw_medial_mm,
        "true_lateral_mm": knee.jsw_lateral_mm,
        "inter_margin_mm": truth.readings.get("inter_margin_mm"),
        "beam_angle_deg": protocol.beam_angle_deg,
        **{name: getattr(protocol, name) for name in ("rotation_deg", "flexion_deg", "sdd_mm", "sod_mm")},
    }


def _measure_distances(built: BuiltKnee, labels: Mapping[str, Any]) -> Row:
    """Measure the minimal distances between the bones for the first radiograph of a knee in each view."""
    if labels["month"] or labels["repeat"] or labels["without"]:
        return {}
    medial, lateral = measure_minimal_distances(built)
    return {"distance_medial_mm": medial, "distance_lateral_mm": lateral}


def _read_labels(truth: Truth, magnification: float) -> dict[str, float]:
    """Return the projected joint spaces of a radiograph, at the nominal magnification of the view."""
    assert truth.jsw_medial_mm is not None
    assert truth.jsw_lateral_mm is not None
    return _collect_spaces(truth.jsw_medial_mm, truth.jsw_lateral_mm, truth.jsw_at_mm, magnification)


def _collect_spaces(medial: float, lateral: float, at: Mapping[float, float], factor: float) -> dict[str, float]:
    """Collect the joint spaces of a radiograph: minima, JSW(x) and mean medial JSW, multiplied by a factor."""
    spaces = (medial, lateral, at[FIXED_AT], float(np.mean([at[place] for place in _AREA_AT])))
    return {name: factor * value for name, value in zip(_SPACES, spaces, strict=True)}


def _read_as_human(exact: Mapping[str, float], design: TrialDesign, key: tuple[int, ...]) -> dict[str, float]:
    """Add the error of a human reader to projected joint spaces."""
    rng = make_stream(design.seed, *key)
    return {
        name: value + design.human.bias_mm + design.human.sd_mm * rng.standard_normal() for name, value in exact.items()
    }


def _name_measures(reader: str, measured: Mapping[str, float], knee: Knee, cuts: OarsiThresholds) -> Row:
    """Name the measures of a reader, and add the OARSI grade of medial narrowing that follows from the joint space."""
    healthy_mm = cuts.healthy_jsw_mm("medial", sex=knee.sex, jsw_definition=knee.jsw_definition)
    lost = 1 - measured["medial_mm"] / healthy_mm
    grade = sum(lost >= cut for cut in cuts.narrowing) if np.isfinite(lost) else np.nan
    return {**{f"{reader}_{name}": float(value) for name, value in measured.items()}, f"{reader}_narrowing": grade}


def _simulate(built: BuiltKnee, protocol: Protocol, seed: int) -> Radiograph:
    """Simulate a radiograph without warnings about single images, which would hide the progress bar."""
    with warnings.catch_warnings():
        for category in (ImageNotice, KernelNotice):
            warnings.simplefilter("ignore", category)
        return simulate(built, protocol, rng=seed, engine="scanline", workers=1)


def _read_by_network(shown: Any, nominal: Protocol, side: str, reader: Reader) -> dict[str, float]:
    """Read the joint spaces by the networks, at the nominal magnification; NaN if no knee of the side was read."""
    knees = [knee for knee in read_knees(np.asarray(shown, np.float32), None, reader) if knee.side == side]
    if not knees or knees[0].refusal:
        return dict.fromkeys(_SPACES, float("nan"))
    measures = knees[0].measures
    width_mm = measures.plateau_width_px * nominal.pixel_mm * nominal.sod_mm / nominal.sdd_mm
    return _collect_spaces(measures.medial_jsw_share, measures.lateral_jsw_share, measures.jsw_at_share, width_mm)


def _measure_texture(radiograph: Radiograph, side: str, shown: Any) -> Row:
    """Measure the texture of the medial subchondral region of an image; NaN if it cannot be measured."""
    assert radiograph.truth is not None
    pixel_mm = radiograph.protocol.pixel_mm
    pixels = np.asarray(shown, np.float64)
    try:
        mask = make_texture_region(_TEXTURE_REGION, radiograph.truth.landmarks_px, pixels, side=side, pixel_mm=pixel_mm)
        values = measure_texture_features(pixels, pixel_mm=pixel_mm, mask=mask, families=("vot", "fsa"))
    except UnmeasurableTextureError:
        return dict.fromkeys(TEXTURES, float("nan"))
    mirrored = mirror_texture_features(values) if side == "left" else values
    return {name: mirrored[name] for name in TEXTURES}
