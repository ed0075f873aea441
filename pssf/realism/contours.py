"""Contour landmarks of drawn knees beside people's: means, spreads, modes of variation, joint gaps.

Everything is in the frame of `data/landmarks.toml`: x from the lateral to the medial edge of the plateau, both edges at
y = 0, in shares of the plateau's width. Only gaps and width are in millimetres on the film.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..anatomy.attrition import outer_bones
from ..anatomy.bone_build import build_of
from ..anatomy.joint import assemble
from ..anatomy.landmarks import CONTOUR_LANDMARKS, contour_landmarks
from ..core.checks import Array, InputError
from ..core.parallel import ordered_map
from ..data.anatomy import AnatomyTables
from ..data.landmarks import GradeContours, LandmarkReference
from ..data.records import Pair, encoded
from ..geometry.view import view_of
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..study.statistics.metrics import auc_with_interval
from . import contour_figure
from .kept import Arrived, KeptRows

Row = dict[str, Any]
# A mean is inside within half a standard deviation of people's, a spread from 0.7 to 1.4 of theirs.
MEAN_WITHIN_SD, SPREAD_WITHIN = 0.5, (0.7, 1.4)
EDGES = tuple(name for name in CONTOUR_LANDMARKS if name.endswith("_edge"))
# Of a table of landmarks, one knee a row.
_COLUMNS = tuple(f"{name}_{axis}_mm" for name in CONTOUR_LANDMARKS for axis in "xy")
_TIBIA, _FEMUR = slice(0, 9), slice(9, 16)
# Least gaps are sought at these shares of the femur's width from its edge.
_GAP_SHARES = np.linspace(0.1, 0.3, 81)
_GAPS_AT = {"0150": 0.15, "0200": 0.2, "0250": 0.25, "0300": 0.3}
# Of the chance that takings are drawn by, beside those of `run`.
_TAKINGS = 303


@dataclass(frozen=True, kw_only=True, eq=False)
class LandmarkSample:
    """Landmarks of several knees.

    places_mm  (n, 16, 2)  on the film in the order of `CONTOUR_LANDMARKS`: x towards medial, y proximal
    grades     (n,)
    """

    places_mm: Array
    grades: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class ContourComparison:
    """Drawn knees beside people, by grade.

    landmarks  grade, landmark, axis, knees, mean, reference, off_sd, mean_inside, sd, reference_sd, spread_ratio,
               spread_inside
    sizes      the same of plateau width, gaps and convergence, with quantity in the place of landmark and axis
    gap_alone  grade, knees, auc, low, high, people, people_low, people_high: of the smaller least gap against grade 0;
               empty without that grade
    outside    grade, knees, outside, of: heights and their spreads of the landmarks that are no edge
    modes      mode, share_of_variance, reference_share, cosine, nearest, nearest_cosine, sd_along, reference_sd: of
               grades 0 and 1; empty for fewer than three such knees
    figure     PNG: mean contours with ellipses of one SD
    """

    landmarks: list[Row]
    sizes: list[Row]
    gap_alone: list[Row]
    outside: list[Row]
    modes: list[Row]
    figure: bytes


def takings_of(knees: Sequence[Knee], draw: Callable[..., Protocol], seed: int) -> list[tuple[Knee, Protocol]]:
    """Knees, each with a taking of its own, as people's films are takings of a view.

    draw  a taking, by a generator `rng`
    """
    takings = []
    for number, knee in enumerate(knees):
        chance = np.random.SeedSequence(seed, spawn_key=(_TAKINGS, number))
        takings.append((knee, draw(rng=np.random.default_rng(chance))))
    return takings


def drawn_landmarks(
    takings: Sequence[tuple[Knee, Protocol]],
    tables: AnatomyTables,
    defined_under: Protocol,
    workers: int = 1,
    kept: KeptRows | None = None,
) -> LandmarkSample:
    """Landmarks of right knees, each under a protocol of its own.

    tables         that bones are made from
    defined_under  the protocol of `defining_protocol`
    kept           where those of an earlier run are taken from, and these put; None: all are made
    """
    shared = {"tables": tables, "defined_under": defined_under}
    measure = partial(ordered_map, _landmarks_of, shared=shared, workers=workers)
    if kept is None:
        places = measure(takings)
    else:

        def make(missing: list[int], arrived: Arrived) -> None:
            measure([takings[number] for number in missing], arrived=lambda nth, of: arrived(nth, _row_of(of)))

        rows = kept.completed([encoded(*taking, defined_under) for taking in takings], make)
        places = [np.array([row[name] for name in _COLUMNS]).reshape(-1, 2) for row in rows]
    return LandmarkSample(places_mm=np.array(places), grades=np.array([knee.grade for knee, _ in takings]))


def _row_of(places_mm: Array) -> Row:
    return dict(zip(_COLUMNS, places_mm.ravel().tolist(), strict=True))


def _landmarks_of(taking: tuple[Knee, Protocol], tables: AnatomyTables, defined_under: Protocol) -> Array:
    """(16, 2)  the labels of a right knee, without building what they do not need"""
    knee, protocol = taking
    assembly = assemble(knee, build_of(knee, tables), protocol.posture, defined_under)
    femur, tibia = (assembly.mirrored(mesh) for mesh in outer_bones(assembly))
    view = view_of(protocol)
    return film_mm(contour_landmarks(femur, tibia, view, 1, assembly.pose.lean_deg), "right", view.pixel_mm)


def film_mm(landmarks_px: dict[str, tuple[float, float]], side: str, pixel_mm: float) -> Array:
    """(16, 2)  contour landmarks of a radiograph in film millimetres: x towards medial, y proximal"""
    medial = 1.0 if side == "right" else -1.0
    places = np.array([landmarks_px[name] for name in CONTOUR_LANDMARKS])
    return np.column_stack((places[:, 1] * medial, -places[:, 0])) * pixel_mm


def plateau_frame(places_mm: Array) -> tuple[Array, Array]:
    """(n, 16, 2), (n,)  landmarks in shares of the plateau's width, and that width, mm

    places_mm  (n, 16, 2)  x towards medial, y proximal
    raises     InputError for a plateau without width
    """
    lateral, medial = (places_mm[:, CONTOUR_LANDMARKS.index(f"tibia_{side}_edge")] for side in ("lateral", "medial"))
    across = medial - lateral
    width = np.linalg.norm(across, axis=1)
    if not (width > 0).all():
        raise InputError(f"landmarks: plateau width = {width.min():g} mm; allowed: more than 0 mm")
    along = across / width[:, None]
    axes = np.stack((along, np.column_stack((-along[:, 1], along[:, 0]))), axis=2)
    shares = (places_mm - ((lateral + medial) / 2)[:, None]) @ axes / width[:, None, None]
    return shares, width


def joint_sizes(places_mm: Array) -> dict[str, Array]:
    """Plateau width, gaps and convergence of each knee, by the names of `GradeContours`.

    A gap is between the straight lines through the landmarks, at a share of the femur's width from its edge; least ones
    are between 0.1 and 0.3. The convergence is of the line through the condyles against that through the plateau's
    edges; positive opens medially.
    places_mm  (n, 16, 2)  x towards medial, y proximal
    """
    shares, width = plateau_frame(places_mm)
    sizes = {"plateau_width_mm": width}
    asked = np.concatenate((_GAP_SHARES, list(_GAPS_AT.values())))
    for side in ("medial", "lateral"):
        gaps = width[:, None] * np.array([_gaps(knee, side, asked) for knee in shares])
        sizes[f"{side}_gap_least_mm"] = gaps[:, : len(_GAP_SHARES)].min(axis=1)
        if side == "medial":
            sizes |= {f"medial_gap_at_{at}_mm": gaps[:, k - len(_GAPS_AT)] for k, at in enumerate(_GAPS_AT)}
    lateral, medial = (shares[:, CONTOUR_LANDMARKS.index(f"femur_{side}_condyle")] for side in ("lateral", "medial"))
    across = medial - lateral
    return sizes | {"lines_converge_deg": np.rad2deg(np.arctan2(across[:, 1], across[:, 0]))}


def compare(sample: LandmarkSample, reference: LandmarkReference) -> ContourComparison:
    """Landmarks of drawn knees beside people's, grade by grade, for the grades that both have.

    raises  InputError for fewer than two knees of a grade, which have no spread, or no grade that the reference has
    """
    shares, _ = plateau_frame(sample.places_mm)
    sizes = joint_sizes(sample.places_mm)
    grades = [grade for grade in np.unique(sample.grades) if str(grade) in reference.grade]
    if not grades:
        given = ", ".join(map(str, np.unique(sample.grades))) or "none"
        raise InputError(f"grades = {given}; allowed: some of {', '.join(reference.grade)}")
    landmark_rows, size_rows, outside = list[Row](), list[Row](), list[Row]()
    panels = []
    for grade in grades:
        chosen, known = sample.grades == grade, reference.grade[str(grade)]
        if chosen.sum() < 2:
            raise InputError(f"grade {grade}: knees = {chosen.sum()}; allowed: 2 or more")
        rows = _landmark_rows(int(grade), shares[chosen], known)
        heights = [row for row in rows if row["axis"] == "y" and row["landmark"] not in EDGES]
        count = sum((not row["mean_inside"]) + (not row["spread_inside"]) for row in heights)
        outside.append({"grade": int(grade), "knees": int(chosen.sum()), "outside": count, "of": 2 * len(heights)})
        landmark_rows += rows
        drawn = (shares[chosen].mean(axis=0), shares[chosen].std(axis=0, ddof=1))
        panels.append((int(grade), drawn, (np.array(known.mean_share), np.array(known.sd_share))))
        size_rows += [
            {"grade": int(grade), "quantity": name, **_beside(values[chosen], getattr(known, name))}
            for name, values in sizes.items()
        ]
    early = shares[np.isin(sample.grades, (0, 1))]
    modes = _mode_rows(early, reference) if len(early) > 2 else []
    return ContourComparison(
        landmarks=landmark_rows,
        sizes=size_rows,
        gap_alone=_gap_alone_rows(sizes, sample.grades, reference),
        outside=outside,
        modes=modes,
        figure=contour_figure.draw(panels),
    )


def _gap_alone_rows(sizes: dict[str, Array], grades: np.ndarray, reference: LandmarkReference) -> list[Row]:
    """How well the smaller least gap alone tells each grade from grade 0, narrower being worse."""
    narrow = -np.minimum(sizes["medial_gap_least_mm"], sizes["lateral_gap_least_mm"])
    rows = []
    for grade in np.unique(grades[grades > 0]):
        people = reference.gap_alone_auc.get(f"kl{grade}")
        chosen = np.isin(grades, (0, grade))
        if people is None or not (grades == 0).any():
            continue
        beside = dict(zip(("people", "people_low", "people_high"), people, strict=True))
        measured = auc_with_interval(grades[chosen] == grade, narrow[chosen])
        rows.append({"grade": int(grade), "knees": int(chosen.sum()), **measured, **beside})
    return rows


def _gaps(shares: Array, side: str, asked: Array) -> Array:
    """(k,)  gaps at shares of the femur's width from its edge"""
    femur, tibia = shares[_FEMUR], shares[_TIBIA]
    width = femur[-1, 0] - femur[0, 0]
    x = femur[-1, 0] - asked * width if side == "medial" else femur[0, 0] + asked * width
    return np.interp(x, *femur.T) - np.interp(x, *tibia.T)


def _landmark_rows(grade: int, shares: Array, known: GradeContours) -> list[Row]:
    rows = []
    for index, name in enumerate(CONTOUR_LANDMARKS):
        for axis, letter in enumerate("xy"):
            mean_sd = known.mean_share[index][axis], known.sd_share[index][axis]
            # The plateau's own edges are the frame, and neither vary nor differ.
            if mean_sd[1] > 0:
                beside = _beside(shares[:, index, axis], mean_sd)
                rows.append({"grade": grade, "landmark": name, "axis": letter, **beside})
    return rows


def _beside(values: Array, reference: Pair) -> Row:
    """Mean and spread of values (n,) beside people's."""
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    off, ratio = (mean - reference[0]) / reference[1], sd / reference[1]
    return {
        "knees": len(values),
        "mean": mean,
        "reference": reference[0],
        "off_sd": off,
        "mean_inside": abs(off) <= MEAN_WITHIN_SD,
        "sd": sd,
        "reference_sd": reference[1],
        "spread_ratio": ratio,
        "spread_inside": SPREAD_WITHIN[0] <= ratio <= SPREAD_WITHIN[1],
    }


def _mode_rows(shares: Array, reference: LandmarkReference) -> list[Row]:
    """Principal components of shares (n, 16, 2) beside people's."""
    flat = shares.reshape(len(shares), -1)
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
            "share_of_variance": float(variance[mode] / variance.sum()),
            "reference_share": reference.modes.share_of_variance[mode],
            "cosine": float(cosines[mode, mode]),
            "nearest": nearest + 1,
            "nearest_cosine": float(cosines[mode, nearest]),
            "sd_along": float((flat @ known[mode]).std(ddof=1)),
            "reference_sd": reference.modes.sd[mode],
        })  # fmt: skip
    return rows
