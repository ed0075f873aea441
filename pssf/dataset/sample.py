"""Make one labelled image: simulation, display processing, label map and crop."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..anatomy import BuiltKnee, BuiltPair, build, build_pair
from ..core.random_streams import make_stream
from ..data.imaging.display_table import FlatPanelProcessing
from ..detector.display_rendering import render_for_display
from ..image_faults import ImageNotice
from ..model.knee import Knee, knee_to_dict
from ..model.protocol import Protocol
from ..model.radiograph import Radiograph, Truth
from ..model.sampling.display_sampling import sample_processing_from_table
from ..raycast.detector_clearance import move_clear_of_detector
from ..simulation import KernelNotice, simulate
from .dataset_plan import PlannedImage
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables
from .label_map import add_joint_space_masks, draw_label_map

# Fields of the protocol that describe the X-ray equipment.
_TECHNIQUE = ("focal_spot_mm", "filtration_mm_al", "grid_ratio", "grid_lines_per_cm")
# Keys that separate the random streams of one image; `randomisation` uses further keys of its transforms.
DISPLAY_KEY, CROP_KEY, RANDOMISE_KEY = 1, 2, 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """Labelled image of a data set.

    Attributes
    ----------
    name, subject, split : str
        Names of image and subject, and subset.
    linear : (rows, cols) uint16 array
        Pixel values, linear in the absorbed energy.
    display : (rows, cols) uint8 array
        Image processed for display, with bright bone.
    label_map : (rows, cols) uint8 array
        Class of each pixel; see `data.imaging.dataset_table`.
    masks : mapping of str to (rows, cols) bool array
        Masks of bones, osteophytes, cysts, joint space and implants, which may overlap.
    maps : mapping of str to (rows, cols) float32 array
        Path length in each requested material, in mm.
    landmarks_px : mapping of str to (row, column) tuple
        Landmark positions in pixels.
    pixel_mm : float
        Pixel size on the detector, in mm.
    labels : mapping of str to object
        JSON-ready labels and parameters.
    """

    name: str
    subject: str
    split: str
    linear: NDArray[np.uint16]
    display: NDArray[np.uint8]
    label_map: NDArray[np.uint8]
    masks: Mapping[str, NDArray[np.bool_]]
    landmarks_px: Mapping[str, tuple[float, float]]
    pixel_mm: float
    labels: Mapping[str, Any]
    maps: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)


def make_sample(planned: PlannedImage, settings: DatasetSettings, tables: DatasetTables) -> Sample:
    """Simulate a planned image and prepare its labels, without randomisation.

    Parameters
    ----------
    planned : PlannedImage
        Knee, protocol and seed of the image.
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Result of `load_dataset_tables`.

    Returns
    -------
    Sample
        Image with its labels.

    Raises
    ------
    InputError
        If the knee cannot be built.
    """
    radiograph, notices = _simulate(planned, settings)
    # The labels of a bilateral radiograph are those of the right and the left knee.
    truth = radiograph.truth if planned.other is None else radiograph.truths[("right", "left").index(planned.knee.side)]
    assert truth is not None
    processing: str | FlatPanelProcessing = settings.display
    if settings.display == "sampled":
        processing = sample_processing_from_table(tables.display, rng=make_stream(planned.appearance_seed, DISPLAY_KEY))
    display = render_for_display(radiograph, processing=processing).astype(np.uint8)
    masks = add_joint_space_masks(truth.masks, truth.landmarks_px)
    sample = Sample(
        name=planned.name,
        subject=planned.subject,
        split=planned.split,
        linear=radiograph.pixels,
        display=display,
        label_map=draw_label_map(masks, tables.definitions.label_map, radiograph.pixels.shape),
        masks=masks,
        landmarks_px=truth.landmarks_px,
        pixel_mm=radiograph.protocol.pixel_mm,
        labels=_collect_labels(planned, radiograph, truth, processing) | {"warnings": notices},
        # A requested material that the knee does not contain has a map of zeros.
        maps={name: radiograph.kept["path_mm"].get(name, np.zeros_like(display, np.float32)) for name in settings.maps},
    )
    return _crop(sample, settings, planned.appearance_seed) if settings.crop_mm else sample


def _simulate(planned: PlannedImage, settings: DatasetSettings) -> tuple[Radiograph, list[str]]:
    """Simulate the radiograph of a planned image; also return the messages of warnings."""
    keep = ("masks", "path_mm") if settings.maps else ("masks",)
    if planned.other is None:
        built = build(planned.knee, planned.protocol)
        return _simulate_built(built, built.aim_beam(planned.protocol), planned.seed, keep, settings.engine)
    right, left = sorted((planned.knee, planned.other), key=lambda knee: knee.side, reverse=True)
    return _simulate_both_knees(right, left, planned.protocol, planned.seed, keep, settings.engine)


# The images of both knees of a subject follow one another and are parts of the same radiograph.
@lru_cache(maxsize=1)
def _simulate_both_knees(
    right: Knee, left: Knee, protocol: Protocol, seed: int, keep: tuple[str, ...], engine: str
) -> tuple[Radiograph, list[str]]:
    """Simulate the radiograph of both knees, or return it if it was simulated last."""
    return _simulate_built(build_pair(right, left, protocol), protocol, seed, keep, engine)


def _simulate_built(
    built: BuiltKnee | BuiltPair, protocol: Protocol, seed: int, keep: tuple[str, ...], engine: str
) -> tuple[Radiograph, list[str]]:
    """Simulate the radiograph of one or two built knees; also return the messages of warnings."""
    protocol = move_clear_of_detector(built.scene, protocol)
    # Printed warnings would hide the progress bar, so they are stored in the label `warnings`.
    with warnings.catch_warnings(record=True) as notices:
        warnings.simplefilter("ignore")
        for category in (ImageNotice, KernelNotice):
            warnings.simplefilter("always", category)
        radiograph = simulate(built, protocol, rng=seed, keep=keep, engine=engine, workers=1)
    return radiograph, [str(notice.message) for notice in notices]


def _collect_labels(
    planned: PlannedImage, radiograph: Radiograph, truth: Truth, processing: str | FlatPanelProcessing
) -> dict[str, Any]:
    """Collect the labels and parameters of an image as JSON-ready values."""
    knee, protocol = knee_to_dict(planned.knee), radiograph.protocol
    labels: dict[str, Any] = {
        "side": knee["side"],
        "sex": knee["sex"],
        "age_years": knee["age_years"],
        "bmi": knee["bmi"],
        "kl": truth.grade,
        "kl_read": truth.reader_grade,
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "jsw_at_mm": {f"{at:g}": round(wide, 4) for at, wide in truth.jsw_at_mm.items()},
        "readings": dict(truth.readings),
        "attrition_mm": dict(truth.attrition_mm),
        "protocol": protocol.name,
        "acquisition": dict(truth.acquisition),
        "technique": {name: getattr(protocol, name) for name in _TECHNIQUE},
        "display": processing if isinstance(processing, str) else _describe_processing(processing),
        "seed": planned.seed,
        "appearance_seed": planned.appearance_seed,
        "knee": knee,
    }
    if planned.other is not None:
        labels["other_knee"] = knee_to_dict(planned.other)
    if planned.pair:
        labels |= {"pair": planned.pair, "role": planned.role, "change": dict(planned.change)}
    return labels


def _describe_processing(processing: FlatPanelProcessing) -> dict[str, float]:
    """Return the numbers of a display processing, keyed by name."""
    fields = {name: getattr(processing, name) for name in processing.__struct_fields__}
    return {name: value for name, value in fields.items() if isinstance(value, int | float)}


def _crop(sample: Sample, settings: DatasetSettings, seed: int) -> Sample:
    """Cut a square around the joint to complete pixels; pixels outside the image have the value of its edge."""
    side, most_px = round(settings.crop_mm / sample.pixel_mm), 2 * settings.crop_shift_mm / sample.pixel_mm
    shift_px = np.clip(make_stream(seed, CROP_KEY).normal(0.0, most_px / 2, 2), -most_px, most_px)
    top, left = (int(at) for at in np.rint(np.array(_find_centre_px(sample)) + shift_px - (side - 1) / 2))
    rows, cols = sample.linear.shape
    inside = np.ix_(*(np.clip(np.arange(at, at + side), 0, n - 1) for at, n in ((top, rows), (left, cols))))
    return replace(
        sample,
        linear=sample.linear[inside],
        display=sample.display[inside],
        label_map=sample.label_map[inside],
        masks={name: mask[inside] for name, mask in sample.masks.items()},
        maps={name: of[inside] for name, of in sample.maps.items()},
        landmarks_px={name: (row - top, col - left) for name, (row, col) in sample.landmarks_px.items()},
        labels={**sample.labels, "crop": {"top_px": top, "left_px": left, "whole_rows": rows, "whole_cols": cols}},
    )


def _find_centre_px(sample: Sample) -> tuple[float, float]:
    """Return the centre of the joint, or the centre of the landmarks in a view without a visible joint space."""
    if "joint_centre" in sample.landmarks_px:
        return sample.landmarks_px["joint_centre"]
    row, col = np.mean(list(sample.landmarks_px.values()), axis=0).tolist()
    return row, col
