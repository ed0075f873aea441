"""Compare contour landmarks of simulated knees and patients: means, SDs, modes of variation and joint gaps.

Landmarks are in the frame of ``data/landmarks.toml``, as fractions of the plateau width. The x axis points from the
lateral to the medial plateau edge, and both edges are at y = 0. Gaps and widths are in mm at the detector.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ...anatomy.outlines.contour_landmarks import find_contour_landmarks
from ...anatomy.posture.attrition import build_outer_meshes
from ...anatomy.posture.knee_assembly import assemble_knee
from ...anatomy.template.bone_builder import resolve_bone_parameters
from ...core.checks import Array, InputError
from ...core.label_names import CONTOUR_LANDMARKS
from ...core.processes.parallel_map import map_in_parallel
from ...data.analysis.landmark_table import GradeLandmarkStatistics, LandmarkReference
from ...data.anatomy.anatomy_tables import AnatomyTables
from ...data.table_records import Pair, encode_records
from ...geometry.view import resolve_view
from ...model.knee import Knee
from ...model.protocol import Protocol
from ...reader.joint_measures import GAP_FRACTIONS, compute_convergence_deg, compute_gaps, normalise_to_plateau
from ...study.statistics.scores.metrics import auc_with_interval
from ..checkpoint import RowCallback, RowCheckpoint
from . import landmark_figure

Row = dict[str, Any]
# Tolerance for the difference between simulated and patient means, in patient standard deviations.
MEAN_WITHIN_SD = 0.5
# Tolerance range for the simulated standard deviation, divided by the patient standard deviation.
SPREAD_WITHIN = (0.7, 1.4)
# Plateau edge landmarks, which define the coordinate frame.
EDGE_LANDMARKS = tuple(name for name in CONTOUR_LANDMARKS if name.endswith("_edge"))
# Coordinate columns of the landmark table, which has one row per knee.
_COLUMNS = tuple(f"{name}_{axis}_mm" for name in CONTOUR_LANDMARKS for axis in "xy")
_NAMED_GAP_FRACTIONS = {"0150": 0.15, "0200": 0.2, "0250": 0.25, "0300": 0.3}
# Key of the random stream for acquisitions; `comparison_run` uses other keys.
_ACQUISITION_STREAM = 303


@dataclass(frozen=True, kw_only=True, eq=False)
class LandmarkSample:
    """Contour landmarks and grades of several knees.

    Parameters
    ----------
    landmarks_mm : (n, 16, 2) array
        Landmark positions at the detector in mm, x medial and y proximal, in the order of ``CONTOUR_LANDMARKS``.
    grades : (n,) array
        KL grade of each knee.
    """

    landmarks_mm: Array
    grades: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class ContourComparison:
    """Result of :func:`compare_contours`.

    Attributes
    ----------
    landmarks : list of dict
        One row per grade, landmark and axis: ``knees``, ``simulated_mean``, ``patient_mean``,
        ``difference_sd``, ``mean_inside``, ``simulated_sd``, ``patient_sd``, ``sd_ratio`` and ``sd_inside``.
    sizes : list of dict
        One row per grade and quantity (plateau width, gaps, convergence). The columns are the same as in `landmarks`,
        except that ``quantity`` replaces landmark and axis.
    gap_auc : list of dict
        AUC of the smaller compartment gap for each grade against grade 0, for simulated knees (``auc``, ``low``,
        ``high``) and patients (``patient_auc``, ``patient_auc_low``, ``patient_auc_high``); empty without grade 0.
    outside : list of dict
        One row per grade: the number of means and standard deviations of landmark heights (``total``), and how many of
        them are outside the tolerance (``outside``). Plateau edges are not counted.
    modes : list of dict
        Modes of landmark variation in grades 0 and 1: ``mode``, ``simulated_variance_fraction``,
        ``patient_variance_fraction``, ``cosine``, ``nearest``, ``nearest_cosine``, ``simulated_sd`` and ``patient_sd``.
        Both standard deviations are along the patient mode. The list is empty for fewer than three knees.
    figure : bytes
        PNG image of the mean contours with one-SD ellipses.
    """

    landmarks: list[Row]
    sizes: list[Row]
    gap_auc: list[Row]
    outside: list[Row]
    modes: list[Row]
    figure: bytes


def sample_acquisitions(
    knees: Sequence[Knee], sample_protocol: Callable[..., Protocol], seed: int
) -> list[tuple[Knee, Protocol]]:
    """Sample one acquisition for every knee.

    Parameters
    ----------
    knees : sequence of Knee
        Knees to image.
    sample_protocol : callable
        Function that samples an acquisition; it is called with the keyword argument `rng`, a random generator.
    seed : int
        Seed of the random acquisitions.

    Returns
    -------
    list of tuple of (Knee, Protocol)
        Pairs of a knee and its sampled acquisition.
    """
    takings = []
    for number, knee in enumerate(knees):
        chance = np.random.SeedSequence(seed, spawn_key=(_ACQUISITION_STREAM, number))
        takings.append((knee, sample_protocol(rng=np.random.default_rng(chance))))
    return takings


def compute_simulated_landmarks(
    acquisitions: Sequence[tuple[Knee, Protocol]],
    tables: AnatomyTables,
    defined_under: Protocol,
    workers: int = 1,
    checkpoint: RowCheckpoint | None = None,
) -> LandmarkSample:
    """Compute the contour landmarks of right knees, each with its own acquisition protocol.

    Parameters
    ----------
    acquisitions : sequence of tuple of (Knee, Protocol)
        Pairs of a knee and its sampled acquisition.
    tables : AnatomyTables
        Anatomy tables from which bones are built.
    defined_under : Protocol
        Protocol that defines the joint space width, from ``load_jsw_protocol``.
    workers : int, default 1
        Number of worker processes.
    checkpoint : RowCheckpoint or None, default None
        Checkpoint with the landmarks of earlier runs; None disables the reuse of landmarks.

    Returns
    -------
    LandmarkSample
        Contour landmarks and KL grades.
    """
    shared = {"tables": tables, "defined_under": defined_under}
    measure = partial(map_in_parallel, _compute_landmarks, shared=shared, workers=workers)
    if checkpoint is None:
        places = measure(acquisitions)
    else:

        def make(missing: list[int], arrived: RowCallback) -> None:
            measure(
                [acquisitions[number] for number in missing],
                on_result=lambda nth, of: arrived(nth, _make_landmark_row(of)),
            )

        rows = checkpoint.complete([encode_records(*acquisition, defined_under) for acquisition in acquisitions], make)
        places = [np.array([row[name] for name in _COLUMNS]).reshape(-1, 2) for row in rows]
    return LandmarkSample(landmarks_mm=np.array(places), grades=np.array([knee.grade for knee, _ in acquisitions]))


def _make_landmark_row(places_mm: Array) -> Row:
    """Convert (16, 2) landmarks to one table row."""
    return dict(zip(_COLUMNS, places_mm.ravel().tolist(), strict=True))


def _compute_landmarks(acquisition: tuple[Knee, Protocol], tables: AnatomyTables, defined_under: Protocol) -> Array:
    """Compute the landmark labels (16, 2) of a right knee, in mm, from its outer bone surfaces."""
    knee, protocol = acquisition
    assembly = assemble_knee(knee, resolve_bone_parameters(knee, tables), protocol.posture, defined_under)
    femur, tibia = (assembly.orient_mesh(mesh) for mesh in build_outer_meshes(assembly))
    view = resolve_view(protocol)
    return convert_landmarks_to_mm(
        find_contour_landmarks(femur, tibia, view, 1, assembly.pose.lean_deg), "right", view.pixel_mm
    )


def convert_landmarks_to_mm(landmarks_px: dict[str, tuple[float, float]], side: str, pixel_mm: float) -> Array:
    """Convert the contour landmarks of a radiograph to mm at the detector; x is medial, y is proximal.

    Parameters
    ----------
    landmarks_px : dict of str to tuple of float
        Row and column of each landmark in pixels, keyed by landmark name.
    side : {"right", "left"}
        Side of the knee.
    pixel_mm : float
        Pixel pitch in mm.

    Returns
    -------
    (16, 2) array
        Landmarks in mm.
    """
    medial = 1.0 if side == "right" else -1.0
    places = np.array([landmarks_px[name] for name in CONTOUR_LANDMARKS])
    return np.column_stack((places[:, 1] * medial, -places[:, 0])) * pixel_mm


def measure_joint_sizes(places_mm: Array) -> dict[str, Array]:
    """Measure plateau width, joint gaps and joint-line convergence of each knee.

    Parameters
    ----------
    places_mm : (n, 16, 2) array
        Landmarks, x medial and y proximal, in mm.

    Returns
    -------
    dict of str to (n,) array
        Sizes in mm and degrees, keyed by field name of ``GradeLandmarkStatistics``.

    Notes
    -----
    A joint gap is the vertical distance between the femoral and tibial contours, which are interpolated linearly
    between landmarks. The position of a gap is its distance from the femoral edge as a fraction of the femoral width.
    The minimum gap is searched for at fractions from 0.1 to 0.3 of the femoral width. Convergence is the angle between
    the line through the condyles and the line through the plateau edges. It is positive if the joint opens medially.
    """
    shares, width = normalise_to_plateau(places_mm)
    sizes = {"plateau_width_mm": width}
    asked = np.concatenate((GAP_FRACTIONS, list(_NAMED_GAP_FRACTIONS.values())))
    for side in ("medial", "lateral"):
        gaps = width[:, None] * np.array([compute_gaps(knee, side, asked) for knee in shares])
        sizes[f"{side}_gap_least_mm"] = gaps[:, : len(GAP_FRACTIONS)].min(axis=1)
        if side == "medial":
            sizes |= {
                f"medial_gap_at_{at}_mm": gaps[:, k - len(_NAMED_GAP_FRACTIONS)]
                for k, at in enumerate(_NAMED_GAP_FRACTIONS)
            }
    return sizes | {"joint_line_convergence_deg": compute_convergence_deg(shares)}


def compare_contours(sample: LandmarkSample, reference: LandmarkReference) -> ContourComparison:
    """Compare the landmarks of simulated knees and patients for every grade that occurs in both groups.

    Parameters
    ----------
    sample : LandmarkSample
        Landmarks of simulated knees.
    reference : LandmarkReference
        Published landmarks of patients.

    Returns
    -------
    ContourComparison
        Rows of all tables, and the figure.

    Raises
    ------
    InputError
        A grade has fewer than two simulated knees, or `reference` contains none of the grades of `sample`.
    """
    shares, _ = normalise_to_plateau(sample.landmarks_mm)
    sizes = measure_joint_sizes(sample.landmarks_mm)
    grades = [grade for grade in np.unique(sample.grades) if str(grade) in reference.grade]
    if not grades:
        given = ", ".join(map(str, np.unique(sample.grades))) or "none"
        raise InputError(f"grades must include one or more of {', '.join(reference.grade)}, got {given}")
    landmark_rows, size_rows, outside = list[Row](), list[Row](), list[Row]()
    panels = []
    for grade in grades:
        chosen, known = sample.grades == grade, reference.grade[str(grade)]
        if chosen.sum() < 2:
            raise InputError(f"number of knees with grade {grade} must be 2 or more, got {chosen.sum()}")
        rows = _compare_landmarks(int(grade), shares[chosen], known)
        heights = [row for row in rows if row["axis"] == "y" and row["landmark"] not in EDGE_LANDMARKS]
        count = sum((not row["mean_inside"]) + (not row["sd_inside"]) for row in heights)
        outside.append({"grade": int(grade), "knees": int(chosen.sum()), "outside": count, "total": 2 * len(heights)})
        landmark_rows += rows
        drawn = (shares[chosen].mean(axis=0), shares[chosen].std(axis=0, ddof=1))
        panels.append((int(grade), drawn, (np.array(known.mean_share), np.array(known.sd_share))))
        size_rows += [
            {"grade": int(grade), "quantity": name, **_compare_with_reference(values[chosen], getattr(known, name))}
            for name, values in sizes.items()
        ]
    early = shares[np.isin(sample.grades, (0, 1))]
    modes = _compare_modes(early, reference) if len(early) > 2 else []
    return ContourComparison(
        landmarks=landmark_rows,
        sizes=size_rows,
        gap_auc=_compute_gap_auc_rows(sizes, sample.grades, reference),
        outside=outside,
        modes=modes,
        figure=landmark_figure.plot_contours(panels),
    )


def _compute_gap_auc_rows(sizes: dict[str, Array], grades: np.ndarray, reference: LandmarkReference) -> list[Row]:
    """Compute the AUC with which the smaller compartment gap distinguishes each grade from grade 0."""
    narrow = -np.minimum(sizes["medial_gap_least_mm"], sizes["lateral_gap_least_mm"])
    rows = []
    for grade in np.unique(grades[grades > 0]):
        of_patients = reference.gap_alone_auc.get(f"kl{grade}")
        chosen = np.isin(grades, (0, grade))
        if of_patients is None or not (grades == 0).any():
            continue
        beside = dict(zip(("patient_auc", "patient_auc_low", "patient_auc_high"), of_patients, strict=True))
        measured = auc_with_interval(grades[chosen] == grade, narrow[chosen])
        rows.append({"grade": int(grade), "knees": int(chosen.sum()), **measured, **beside})
    return rows


def _compare_landmarks(grade: int, landmarks: Array, reference: GradeLandmarkStatistics) -> list[Row]:
    """Compare every landmark coordinate of one grade with the published patient values."""
    rows = []
    for index, name in enumerate(CONTOUR_LANDMARKS):
        for axis, letter in enumerate("xy"):
            mean_sd = reference.mean_share[index][axis], reference.sd_share[index][axis]
            # The plateau edges define the coordinate frame, so their coordinates have no variance.
            if mean_sd[1] > 0:
                beside = _compare_with_reference(landmarks[:, index, axis], mean_sd)
                rows.append({"grade": grade, "landmark": name, "axis": letter, **beside})
    return rows


def _compare_with_reference(values: Array, reference: Pair) -> Row:
    """Compare the mean and standard deviation of values (n,) with reference values."""
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    off, ratio = (mean - reference[0]) / reference[1], sd / reference[1]
    return {
        "knees": len(values),
        "simulated_mean": mean,
        "patient_mean": reference[0],
        "difference_sd": off,
        "mean_inside": abs(off) <= MEAN_WITHIN_SD,
        "simulated_sd": sd,
        "patient_sd": reference[1],
        "sd_ratio": ratio,
        "sd_inside": SPREAD_WITHIN[0] <= ratio <= SPREAD_WITHIN[1],
    }


def _compare_modes(landmarks: Array, reference: LandmarkReference) -> list[Row]:
    """Compare the principal components of landmarks (n, 16, 2) with the published components of patients."""
    flat = landmarks.reshape(len(landmarks), -1)
    flat = flat - flat.mean(axis=0)
    _, singular, vectors = np.linalg.svd(flat, full_matrices=False)
    variance = singular**2 / (len(flat) - 1)
    known = np.array(reference.modes.vectors)
    known /= np.linalg.norm(known, axis=1, keepdims=True)
    cosines = np.abs(known @ vectors.T)
    rows = []
    for mode in range(min(len(known), len(vectors))):
        nearest = int(cosines[mode].argmax())
        rows.append({
            "mode": mode + 1,
            "simulated_variance_fraction": float(variance[mode] / variance.sum()),
            "patient_variance_fraction": reference.modes.share_of_variance[mode],
            "cosine": float(cosines[mode, mode]),
            "nearest": nearest + 1,
            "nearest_cosine": float(cosines[mode, nearest]),
            "simulated_sd": float((flat @ known[mode]).std(ddof=1)),
            "patient_sd": reference.modes.sd[mode],
        })  # fmt: skip
    return rows
