"""What beams and turns do to films, measured on drawn knees as it was on people's or on a model.

Knees are those of the table `people`, KL 0 to 2, each taken once (`draw_exposure`). The mean slope of plateaus was
chosen so that fixed flexion has people's margins (`grades/population.toml`); nothing else is fitted to the references.
"""

from dataclasses import replace

import numpy as np

from ..anatomy.attrition import outer_bones
from ..anatomy.bone_build import build_of
from ..anatomy.joint import KneeAssembly, assemble, defining_protocol
from ..anatomy.plateau import along_plateau, inter_margin_mm
from ..anatomy.pose import moved
from ..anatomy.turned_truth import trochlea_px
from ..core.checks import Array
from ..core.parallel import ordered_map
from ..data.anatomy import AnatomyTables, anatomy_tables
from ..data.fields import beam_range_deg
from ..data.records import Pair
from ..data.references import Known, references
from ..geometry.mesh import Mesh
from ..geometry.view import project, view_of
from ..model.draw import draw_knee
from ..model.exposure import draw_exposure
from ..model.knee import Knee
from ..model.protocol import load_protocol
from .engines import Row

# Margins no farther apart are taken for aligned (judgement; the source's own bound is not in its abstract).
ALIGNED_MM = 1.5
_FIXED_DEG = 11.0
# A reader's tangent to the medial plateau, at 30 degrees to its horizontal, touches its front and its back edge.
_TOUCH_DEG, _ABOVE_MM, _INNER, _OUTER = 30.0, -30.0, 0.36, 0.85
# Other readings of what sources do not say, beside the same reference: a wider bound, a taking that misses by more, and
# the shaft's axis as a film shows it, through the middles or the fronts of its outline at two heights.
_WIDER_MM, _MISSED_BY = 2.5, 1.6
_AXES_MM, _BAND_MM = (-120.0, -60.0), 6.0
_OTHERWISE = {
    "inter_margin_missed_by_more_mm": "inter_margin_lyon_schuss_mm",
    "aligned_within_more_percent": "aligned_at_11_deg_percent",
    "slope_per_rotation_outline_deg": "slope_per_rotation_deg",
    "slope_per_rotation_front_deg": "slope_per_rotation_deg",
}
# Turns of the leg from where a lateral is meant to be; more than any that is not taken again.
TURNS_DEG = (-10.0, -5.0, 0.0, 5.0, 10.0)


def view_rows(count: int, workers: int) -> list[Row]:
    """One row a quantity over drawn knees: mean, standard deviation, reference and how far off.

    off  of the mean from the reference, or from the nearer end of its range
    """
    knees = [draw_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="population") for k in range(count)]
    shared = {"tables": anatomy_tables(), "range_deg": beam_range_deg()}
    measured = ordered_map(on_films, list(enumerate(knees)), shared=shared, workers=workers)
    values = {name: np.array([one[name] for one in measured]) for name in measured[0]}
    means = {name: (float(value.mean()), float(value.std(ddof=1))) for name, value in values.items()}
    means["beam_along_plateau_sd_deg"] = (means["beam_along_plateau_deg"][1], float("nan"))
    known = references().views
    rows = []
    for name in known:
        alike = [other for other, first in _OTHERWISE.items() if first == name]
        rows += [_row(one, known[name], means[one], count) for one in (name, *alike)]
    return rows


def _row(name: str, known: Known, measured: tuple[float, float], count: int) -> Row:
    """measured: mean and standard deviation"""
    mean, sd = measured
    low, high = known.range or (known.value, known.value)
    assert low is not None
    assert high is not None
    return {
        "quantity": name,
        "value": round(mean, 3),
        "sd": "" if np.isnan(sd) else round(sd, 3),
        "knees": count,
        "reference": f"{low:g}" if low == high else f"{low:g} to {high:g}",
        "off": round(mean - float(np.clip(mean, low, high)), 3),
        "source": known.source,
    }


def on_films(job: tuple[int, Knee], tables: AnatomyTables, range_deg: Pair) -> dict[str, float]:
    """What is measured on films of one knee: signs of distances and of changes are left out, as readers do.

    job        number of the knee, from which its takings are drawn, and the knee
    range_deg  that a beam may be tilted by
    """
    number, knee = job
    rng = np.random.default_rng([number, 1])
    fixed, schuss = (
        draw_exposure(load_protocol(name), rng=rng, side=knee.side) for name in ("fixed_flexion", "lyon_schuss")
    )
    assembly = assemble(knee, build_of(knee, tables), fixed.posture, defining_protocol(knee))
    tibia = outer_bones(assembly)[1]
    measured = {"inter_margin_fixed_flexion_mm": abs(inter_margin_mm(assembly, tibia, view_of(fixed)))}
    assembly = assemble(knee, build_of(knee, tables), schuss.posture, defining_protocol(knee))
    tibia = outer_bones(assembly)[1]
    aimed = along_plateau(assembly, tibia, schuss, range_deg)
    level = replace(schuss, beam_along="horizontal", beam_angle_deg=_FIXED_DEG)
    missed = replace(schuss, beam_angle_deg=_MISSED_BY * schuss.beam_angle_deg)
    missed = along_plateau(assembly, tibia, missed, range_deg)
    apart_mm = abs(inter_margin_mm(assembly, tibia, view_of(level)))
    measured |= {
        "inter_margin_lyon_schuss_mm": abs(inter_margin_mm(assembly, tibia, view_of(aimed))),
        "inter_margin_missed_by_more_mm": abs(inter_margin_mm(assembly, tibia, view_of(missed))),
        "beam_along_plateau_deg": aimed.beam_angle_deg,
        "aligned_at_11_deg_percent": 100.0 * (apart_mm <= ALIGNED_MM),
        "aligned_within_more_percent": 100.0 * (apart_mm <= _WIDER_MM),
    }
    # A radiographer turns a lateral until the condyles meet, whatever way the foot points by itself.
    turned = replace(knee, rotation_deg=0.0)
    return measured | _slopes(turned, tables) | _sulcus(turned, tables)


def _slopes(knee: Knee, tables: AnatomyTables) -> dict[str, float]:
    protocol = load_protocol("lateral")
    assembly = assemble(knee, build_of(knee, tables), protocol.posture, defining_protocol(knee))
    tibia, frame = outer_bones(assembly)[1], assembly.pose.tibia()
    own = Mesh((tibia.vertices - frame[:, 3]) @ frame[:, :3], tibia.faces)
    turned = [
        replace(assembly, pose=replace(assembly.pose, rotation_deg=assembly.pose.rotation_deg + turn))
        for turn in TURNS_DEG
    ]
    slopes = {axis: [slope_deg(one, own, axis) for one in turned] for axis in ("bone", "outline", "front")}
    # As a reader's: whichever way the slope goes with the turn.
    per_degree = {axis: abs(float(np.polyfit(TURNS_DEG, read, 1)[0])) for axis, read in slopes.items()}
    return {
        "slope_on_lateral_deg": slopes["bone"][TURNS_DEG.index(0.0)],
        "slope_per_rotation_deg": per_degree["bone"],
        "slope_per_rotation_outline_deg": per_degree["outline"],
        "slope_per_rotation_front_deg": per_degree["front"],
    }


def slope_deg(assembly: KneeAssembly, tibia: Mesh, axis: str = "bone") -> float:
    """Fall of the medial plateau backwards on a lateral, between the places that a reader's tangents touch.

    tibia  its outer surface in its own frame
    axis   across which it falls: the bone's own ("bone"), or the shaft's through the middles ("outline") or the fronts
           ("front") of its outline on the film
    """
    view, frame, half = view_of(load_protocol("lateral")), assembly.pose.tibia(), assembly.build.half_ml_mm
    points = tibia.vertices
    medial = points[(points[:, 2] > _ABOVE_MM) & (points[:, 0] > _INNER * half) & (points[:, 0] < _OUTER * half)]

    def seen(places: Array) -> Array:
        return project(assembly.seen(moved(places, frame)), view)

    up, back = _across(seen(np.array([[0.0, 0.0, -100.0], [0.0, 0.0, -20.0]])), assembly.mirror[0])
    if axis != "bone":
        bands = (seen(points[np.abs(points[:, 2] - height_mm) < _BAND_MM]) for height_mm in _AXES_MM)
        up, back = _across(np.array([_shaft_at(band, back, axis) for band in bands]), assembly.mirror[0])
    height, across = seen(medial) @ up, seen(medial) @ back
    turn = np.deg2rad(_TOUCH_DEG)
    front, rear = ((height * np.cos(turn) + way * across * np.sin(turn)).argmax() for way in (-1.0, 1.0))
    return float(np.rad2deg(np.arctan2(height[front] - height[rear], across[rear] - across[front])))


def _shaft_at(outline: Array, back: Array, axis: str) -> Array:
    """(2,)  front of a band of the shaft (n, 2) on the film, or the middle between front and rear, px"""
    across = outline @ back
    front, rear = outline[across.argmin()], outline[across.argmax()]
    return front if axis == "front" else (front + rear) / 2


def _across(ends: Array, mirror: float) -> tuple[Array, Array]:
    """Directions on the film along a shaft from the lower to the upper of two places (2, 2), px, and backwards."""
    up = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return up, np.array([up[1], -up[0]]) * mirror


def _sulcus(knee: Knee, tables: AnatomyTables) -> dict[str, float]:
    protocol = load_protocol("skyline")
    assembly = assemble(knee, build_of(knee, tables), protocol.posture, defining_protocol(knee))
    spots = trochlea_px(assembly, outer_bones(assembly)[0], view_of(protocol))
    middle = np.array(spots["sulcus"])
    ways = [np.array(spots[f"trochlea_{side}"]) - middle for side in ("medial", "lateral")]
    cosine = ways[0] @ ways[1] / np.linalg.norm(ways[0]) / np.linalg.norm(ways[1])
    return {"sulcus_angle_deg": float(np.rad2deg(np.arccos(cosine)))}
