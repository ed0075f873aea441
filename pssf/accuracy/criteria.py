"""What guides to positioning ask of each view, measured on drawn knees; nothing is fitted to it.

Knees are those of the table `people`, KL 0 to 2, as each view is meant, without what a taking misses it by. Lengths are
scaled to the joint plane.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..anatomy import BuiltKnee, build
from ..core.checks import Array
from ..core.parallel import ordered_map
from ..data.references import references
from ..geometry.view import View, magnification, project, view_of
from ..model.draw import draw_knee
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..raycast import shadow
from .engines import Row

Mask = NDArray[np.bool_]
# Of a fibula what is so far below its tip is its head. Of a femur condyles are what is below the second height and
# farther from the middle than the third, at the mean man's size.
_HEAD_MM, _CONDYLE_MM, _ASIDE_MM = 20.0, 20.0, 8.0
_VIEWS, _BONES = ("ap_standing", "rosenberg", "lateral", "skyline"), ("femur", "tibia", "fibula", "patella")


def criterion_rows(count: int, workers: int) -> list[Row]:
    """One row a criterion: view, what is asked, what is measured: mean, standard deviation, least and most."""
    knees = [draw_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="population") for k in range(count)]
    measured = ordered_map(in_views, knees, shared={}, workers=workers)
    rows: list[Row] = []
    for name, criterion in references().criteria.items():
        values = np.array([one[name] for one in measured])
        numbers = {"mean": values.mean(), "sd": values.std(ddof=1), "least": values.min(), "most": values.max()}
        rows.append(
            {"view": criterion.view, "asked": criterion.asked, "quantity": name}
            | {key: round(float(value), 2) for key, value in numbers.items()}
            | {"knees": count}
        )
    return rows


def in_views(knee: Knee) -> dict[str, float]:
    """Quantity -> what it is for one knee, in its unit"""
    # A radiographer turns a lateral until the condyles meet, whatever way the foot points by itself.
    turned = {"lateral": replace(knee, rotation_deg=0.0)}
    protocols = {name: load_protocol(name) for name in _VIEWS}
    built = {name: build(turned.get(name, knee), protocol) for name, protocol in protocols.items()}
    views = {name: view_of(protocol) for name, protocol in protocols.items()}
    ap, lateral, skyline = (_shadows(built[name], views[name]) for name in ("ap_standing", "lateral", "skyline"))
    front, tunnel = (_spots(built[name], views[name]) for name in ("ap_standing", "rosenberg"))
    return {
        **_front(front, ap["patella"], views["ap_standing"]),
        "ap_head_under_tibia_percent": _head_under_tibia_percent(ap, views["ap_standing"]),
        "rosenberg_notch_over_ap": _notch_mm(tunnel, views["rosenberg"]) / _notch_mm(front, views["ap_standing"]),
        "lateral_condyles_apart_mm": _condyles_apart_mm(built["lateral"], views["lateral"]),
        "lateral_head_under_tibia_percent": _head_under_tibia_percent(lateral, views["lateral"]),
        "lateral_patella_clear_mm": _clear_mm(lateral["patella"], lateral["femur"], views["lateral"]),
        "skyline_patella_clear_mm": _clear_mm(skyline["patella"], skyline["femur"], views["skyline"]),
    }


def _shadows(built: BuiltKnee, view: View) -> dict[str, Mask]:
    """Bone -> (rows, cols)  where it is seen"""
    return {one.name: shadow(one.arrays, view) for one in built.scene.surfaces if one.name in _BONES}


def _mm(pixels: float, view: View) -> float:
    return pixels * view.pixel_mm / magnification(view)


def _spots(built: BuiltKnee, view: View) -> dict[str, Array]:
    """Landmark -> (2,)  row and column"""
    return {name: np.array(place) for name, place in built.truth_in(view).landmarks_px.items()}


def _front(spots: dict[str, Array], patella: Mask, view: View) -> dict[str, float]:
    ends = spots["medial_epicondyle"][1], spots["lateral_epicondyle"][1]
    off_px = np.argwhere(patella)[:, 1].mean() - np.mean(ends)
    eminence = (spots["medial_spine"] + spots["lateral_spine"]) / 2
    return {
        "ap_patella_off_middle_percent": float(100 * abs(off_px) / abs(ends[0] - ends[1])),
        "ap_eminence_off_notch_mm": _mm(abs(float(eminence[1] - spots["notch_top"][1])), view),
    }


def _notch_mm(spots: dict[str, Array], view: View) -> float:
    condyles = (spots["femur_medial_condyle"] + spots["femur_lateral_condyle"]) / 2
    return _mm(float(condyles[0] - spots["notch_top"][0]), view)


def _head_under_tibia_percent(seen: dict[str, Mask], view: View) -> float:
    """Share of the fibular head that the tibia overlaps."""
    rows = np.flatnonzero(seen["fibula"].any(axis=1))
    head = seen["fibula"].copy()
    head[rows[0] + round(_HEAD_MM * magnification(view) / view.pixel_mm) :] = False
    return float(100 * (head & seen["tibia"]).sum() / head.sum())


def _clear_mm(one: Mask, other: Mask, view: View) -> float:
    """How far two shadows are apart; 0 where they overlap."""
    return _mm(float(ndimage.distance_transform_edt(~other)[one].min()), view)


def _condyles_apart_mm(built: BuiltKnee, view: View) -> float:
    """How far the outlines of both condyles are apart at their backs."""
    assembly = built.assembly
    points = assembly.femur.mesh.vertices
    columns = project(assembly.seen(assembly.outer_femur_mm()), view)[:, 1]
    # Of a right knee that is seen from its medial side the back is on the right of the film; the other is mirrored.
    back = np.sign(columns @ (points[:, 1] - points[:, 1].mean()))
    backs = [
        (back * columns[(side * points[:, 0] > _ASIDE_MM) & (points[:, 2] < _CONDYLE_MM)]).max() for side in (+1, -1)
    ]
    return _mm(abs(float(backs[0] - backs[1])), view)
