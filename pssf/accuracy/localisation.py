"""Finding the joint on simulations that are right, and on such that are wrong on purpose; limits drawn from these."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..anatomy import build
from ..core.blocks import block_mean
from ..core.checks import InputError
from ..core.parallel import ordered_map
from ..data.localisation import Localisation, localisation
from ..data.shapes import shape_table
from ..experiment import standard_templates
from ..geometry.scene import Scene
from ..geometry.view import magnification, view_of
from ..model.draw import draw_knee
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..simulation import simulate
from .builds import wide_knee
from .engines import Row

if TYPE_CHECKING:
    from ..radiomics.locate import Located
    from ..radiomics.patches import Template

# Drawn knees under the study's protocols; every fourth from all over the ranges of an adult, under any protocol.
STUDY = ("reference", "low_dose", "geometry_shift")
OTHERS = ("long_distance", "caudal_beam", "scatter_grid", "high_kv", "gos_screen", "large_focus")
_SIDE_PX, _REGION_PX = 512, 128
_SOFT = ("skin", "adipose", "muscle")
# Of those without a pitch: pixels that are taken as one, as crops are made smaller.
_BINNED_PX = 2


class _Case(NamedTuple):
    """How a simulation is shown; the reason that it should be refused for; the pitch that is said over the true one.

    pitch  None: it is not said, and neither is the side
    """

    meant: str
    pitch: float | None = 1.0
    bones: bool = True
    upright: bool = True
    mirrored: bool = False


_CASES = {
    "right": _Case("found"),
    "wrong side": _Case("wrong side", mirrored=True),
    "upside down": _Case("upside down", upright=False),
    "without bones": _Case("no knee", bones=False),
    "pitch x 2": _Case("wrong scale", 2.0),
    "pitch x 1.5": _Case("wrong scale", 1.5),
    "pitch x 0.5": _Case("wrong scale", 0.5),
    "right, no pitch": _Case("found", None),
    "upside down, no pitch": _Case("upside down", None, upright=False),
    "without bones, no pitch": _Case("no knee", None, bones=False),
}
_MEASURES = (
    *("score", "narrow", "both", "side_margin", "side_evidence", "way_margin", "way_evidence", "scale", "apart_mm"),
)


def localisation_rows(count: int, workers: int) -> list[Row]:
    """One row a case and kind of knee: how many were found and refused, and for the reason meant; error; scores.

    count  knees, of which three quarters are drawn as a study's, the others from all over the ranges of an adult
    """
    return [
        _row(case, kind, [one for one in located if one["case"] == case and one["kind"] == kind])
        for located in [_located(count, workers, len(shape_table().modes), localisation())]
        for kind in ("study", "adult")
        for case in _CASES
        if any((one["case"], one["kind"]) == (case, kind) for one in located)
    ]


def limit_rows(count: int, workers: int) -> list[Row]:
    """One row a limit: what the simulations give for it, by which rule, and what is in force."""
    table = localisation()
    located, limits = _located(count, workers, len(shape_table().modes), table), table.thresholds

    def values(case: str, measure: str, kinds: tuple[str, ...] = ("study", "adult")) -> NDArray[np.float64]:
        return np.array([one[measure] for one in located if one["case"] == case and one["kind"] in kinds])

    right, enlarged = values("right", "scale", ("study",)), values("pitch x 1.5", "scale", ("study",))
    rules = [
        ("both", values("without bones", "both").max(), limits.both, "highest without bones"),
        ("doubtful", np.quantile(values("without bones, no pitch", "both"), 0.99), limits.doubtful,
         "99 % of those without bones and pitch"),
        ("sided", np.quantile(np.abs(values("without bones, no pitch", "side_evidence")), 0.99), limits.sided,
         "99 % of those without bones and pitch"),
        ("clear", values("without bones, no pitch", "both").max(), limits.clear, "above the highest without bones"),
        ("sure", values("right, no pitch", "both").min(), limits.sure, "about the least of right ones without pitch"),
        ("side", -np.quantile(values("wrong side", "side_evidence"), 0.99), limits.side, "99 % of wrong sides"),
        ("way", np.abs(values("without bones", "way_evidence")).max(), limits.way, "highest without bones"),
        ("apart_mm", sum(values(case, "apart_mm").max() for case in ("right", "without bones")) / 2, limits.apart_mm,
         "between right ones and without bones"),
        ("scale, least", np.sqrt(values("right", "scale").min() * values("pitch x 0.5", "scale").max()),
         limits.scale[0], "between the least of right ones and the largest at half the pitch"),
        ("scale, greatest", np.sqrt(right.max() * np.quantile(enlarged, 0.01)), limits.scale[1],
         "between the greatest of the study's and 99 % of them at 1.5 times the pitch"),
    ]  # fmt: skip
    return [
        {"limit": name, "simulations": round(float(value), 3), "in_force": in_force, "rule": rule, "knees": count}
        for name, value, in_force, rule in rules
    ]


def _row(case: str, kind: str, located: list[Row]) -> Row:
    meant, is_right = _CASES[case].meant, case.startswith("right")
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


@lru_cache(maxsize=1)  # both tables are of the same simulations
def _located(count: int, workers: int, modes: int, table: Localisation) -> list[Row]:
    shared = {"templates": standard_templates("scanline", workers=workers), "modes": modes, "table": table}
    return [row for rows in ordered_map(_of_knee, list(range(count)), shared=shared, workers=workers) for row in rows]


def _of_knee(number: int, *, templates: "tuple[Template, ...]", modes: int, table: Localisation) -> list[Row]:
    """Every case of one knee; nothing where it cannot be built."""
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(2,)))
    kind = "adult" if number % 4 == 3 else "study"
    knee = wide_knee(rng, modes) if kind == "adult" else draw_knee(grade=number % 3, rng=rng, grade_table="paper")
    names = OTHERS if kind == "adult" else STUDY
    protocol = on_fewer_pixels(load_protocol(names[(number // 4 + number) % len(names)]))
    try:
        built = build(knee)
    except InputError:
        return []
    whole = simulate(built, protocol, rng=number, engine="scanline", workers=1)
    soft = Scene([surface for surface in built.scene.surfaces if surface.name in _SOFT])
    bare = simulate(soft, protocol, rng=number, engine="scanline", workers=1)
    assert whole.truth is not None
    rows = []
    for case in _CASES:
        pixels = whole.pixels if _CASES[case].bones else bare.pixels
        joint = _find(_CASES[case], pixels, knee, protocol, templates, table)
        away = np.subtract((joint.row, joint.col), whole.truth.medial_joint_line_px)
        error_mm = float(np.hypot(*away)) * protocol.pixel_mm / magnification(view_of(protocol))
        measures = {name: getattr(joint, name) for name in _MEASURES}
        rows.append({"case": case, "kind": kind, "status": joint.status, "error_mm": error_mm, **measures})
    return rows


def _find(
    case: _Case,
    pixels: NDArray[np.uint16],
    knee: Knee,
    protocol: Protocol,
    templates: "tuple[Template, ...]",
    table: Localisation,
) -> "Located":
    """The joint, in pixels of the image."""
    from ..radiomics.aspect import locate_film
    from ..radiomics.locate import find_joint
    from ..radiomics.patches import density_of

    pixels = pixels if case.upright else pixels[::-1]
    if case.pitch is None:
        joint = locate_film(density_of(block_mean(pixels, _BINNED_PX)), templates, table)
        row, col = (at * _BINNED_PX + (_BINNED_PX - 1) / 2 for at in (joint.row, joint.col))
        return dataclasses.replace(joint, row=row, col=col)
    side = {"right": "left", "left": "right"}[knee.side] if case.mirrored else knee.side
    pixel_mm = protocol.pixel_mm * case.pitch
    return find_joint(pixels, templates, table, side=side, pixel_mm=pixel_mm, region_px=_REGION_PX)


def on_fewer_pixels(protocol: Protocol) -> Protocol:
    """The same field, of as many pixels a side as localisation needs."""
    pixel_mm = protocol.pixel_mm * protocol.cols / _SIDE_PX
    return dataclasses.replace(protocol, rows=_SIDE_PX, cols=_SIDE_PX, pixel_mm=pixel_mm)
