"""Build: what makes one knee's bones of the mean man's, and where a place of his bones is in them.

A bone is made in its own frame at the mean man's size, with a straight shaft. A lattice deforms it into this person's;
its shaft goes straight on beyond the lattice and is set upright, seen from the side; the tibia's plateau gets its
slope, and each shaft its lean in the frontal plane. So an angle of a knee is that of its bones, whatever their form.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..data.anatomy import AnatomyTables
from ..data.bones import BoneShape, FemurShape, GrowthZone, RoughZone, TibiaShape
from ..data.records import Rows
from ..data.spongy import TrabecularBone
from ..geometry.freeform import Lattice, displaced
from ..model.knee import Knee
from .femur import mean_femur
from .mean_bone import MeanBone, Plates
from .roughness import NO_SEEDS, Seeds, growth, roughness
from .shape import knee_form, lattices_of
from .solids import SHAFT_POWER, ring
from .tibia import mean_tibia, plateau_height

# Along this part of a shaft its lean is looked for (mean man's size), with which it goes on beyond; and where the angle
# of shafts is measured (its own size).
_LEAN_FROM_MM, _LEAN_TO_MM, _SHAFT_MM = 55.0, 85.0, (115.0, 165.0)
_AROUND = 48
# The bone next to the joint is about so far from its end.
_JOINT_MM = 15.0
# A lean begins smoothly over this, which keeps the metaphysis free of a kink.
_EASE_MM = 15.0
# Places of the plateau, to the sides and to front and back of its middle, between which its fall is measured.
_PLATEAU_X_MM, _PLATEAU_Y_MM = 22.0, 13.0
_PLATEAU_TURNS = 4
# Of a tibia: a slope reaches down to here, below the tuberosity.
_SLOPE_TO_MM = 60.0


@dataclass(frozen=True, kw_only=True)
class Form:
    """How a person's femur or tibia differs from the mean man's.

    lattice  that deforms it, at the mean man's size, in the bone's frame
    end      +1: the shaft goes up from the joint; -1: down
    lean     (x, y) by which the shaft then leans, a millimetre away from the joint
    slope    by which it leans in x once it is upright from the side
    rough    where it is rough, and the seeds of that
    growth   where it has grown, and by how much, mm
    """

    lattice: Lattice
    end: int
    rough: tuple[RoughZone, ...] = ()
    seeds: Seeds = NO_SEEDS
    growth: tuple[GrowthZone, ...] = ()
    grown_mm: float = 0.0
    lean: tuple[float, float] = (0.0, 0.0)
    slope: float = 0.0

    def upright(self) -> Array:
        """(3, 3)  rotation about x that sets the shaft upright, seen from the side"""
        turn = self.end * np.arctan(self.lean[1])
        cos, sin = np.cos(turn), np.sin(turn)
        return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])

    def frame(self, scale: float) -> Array:
        """(3, 4)  rigid transform from the mean man's frame that what lies in the bone next to the joint follows"""
        joint = np.array([[0.0, 0.0, self.end * _JOINT_MM]])
        turn = self.upright()
        return np.column_stack((turn, (formed(joint, self) - joint @ turn.T)[0] * scale))


@dataclass(frozen=True)
class Build:
    """What shapes the bones of one knee: size over the mean man's, relative cortex and plates, angles in degrees.

    tables            that all of it is made from
    femur, tibia      this person's form of them
    patella           the lattice of this person's
    slope_deg         by which the plateau falls backwards, mean of both sides
    fall              by how much it falls a millimetre before it is sloped
    femur_valgus_deg  by which the femoral shaft leans laterally, proximally
    tibia_varus_deg   by which the tibial shaft leans medially, distally
    seed              of how uneven its cortex is
    """

    tables: AnatomyTables
    femur: Form
    tibia: Form
    patella: Lattice
    scale: float
    cortex: float
    plates: Plates
    slope_deg: float
    fall: float
    femur_valgus_deg: float
    tibia_varus_deg: float
    seed: int

    @property
    def shape(self) -> BoneShape:
        """Of the mean man's bones."""
        return self.tables.shape

    @property
    def mean_femur(self) -> MeanBone:
        """The mean man's femur."""
        return mean_femur(self.tables.shape.femur, self.tables.forms)

    @property
    def mean_tibia(self) -> MeanBone:
        """The mean man's tibia."""
        return mean_tibia(self.tables.shape.tibia, self.tables.forms)

    @property
    def half_ml_mm(self) -> float:
        """Half the medio-lateral width of the tibial plateau."""
        return self.shape.size.male_tibial_ml_mm / 2 * self.scale


def build_of(knee: Knee, tables: AnatomyTables) -> Build:
    """What a knee's parameters make of the mean man's bones."""
    shape, size = tables.shape, tables.shape.size
    sex_scale = size.female_over_male if knee.sex == "female" else 1.0
    scale = sex_scale * knee.bone_scale * knee.stature_mm / getattr(size.stature_mm, knee.sex)
    lattices = lattices_of(knee.shape, knee_form(tables.forms))
    seeds = Seeds(texture=knee.texture_seed, form=knee.form_seed)
    femur, tibia = (
        replace(
            _form(lattices[name], end, getattr(shape, name), scale, seeds),
            growth=getattr(shape.notch_growth, name),
            grown_mm=knee.notch_growth_mm / scale,
        )
        for name, end in (("femur", +1), ("tibia", -1))
    )
    # The tibia leans as this person's does; the femur as makes the angle between them the one of a straight leg. Of an
    # angle beyond that each has half.
    varus = float(np.rad2deg(np.arctan(tibia.slope)))
    return Build(
        tables=tables,
        femur=femur,
        tibia=tibia,
        patella=lattices["patella"],
        scale=scale,
        cortex=knee.cortex_scale,
        plates=_plates(knee, scale, tables.spongy),
        slope_deg=knee.tibial_slope_deg,
        fall=plateau_fall(tibia, shape.tibia),
        femur_valgus_deg=shape.femur.valgus_deg + varus - knee.varus_deg / 2,
        tibia_varus_deg=varus + knee.varus_deg / 2,
        seed=knee.texture_seed,
    )


def _plates(knee: Knee, scale: float, spongy: TrabecularBone) -> Plates:
    """Sclerosis is of the side that bears the load; the other has a share of it."""
    healthy = knee.cortex_scale / scale
    excess, share = knee.subchondral_plate - 1, spongy.sclerosis.other_side
    thick, other = healthy * (1 + excess), healthy * (1 + share * excess)
    medial, lateral = (thick, other) if knee.sclerotic_side == "medial" else (other, thick)
    return Plates(medial, lateral, spongy.side.middle_mm)


def _form(lattice: Lattice, end: int, shape: FemurShape | TibiaShape, scale: float, seeds: Seeds) -> Form:
    sections = shape.sections
    heights = np.linspace(_LEAN_FROM_MM, _LEAN_TO_MM, 5)
    middles = _middles(sections, end * heights, lambda points: displaced(points, lattice))
    lean_x, lean_y = np.polyfit(heights, middles, 1)[0]
    lean = (float(lean_x), float(lean_y))
    form = Form(lattice=lattice, end=end, rough=shape.rough, seeds=seeds, lean=lean)
    heights = np.array(_SHAFT_MM) / scale
    far = _middles(sections, end * heights, lambda points: formed(points, form))
    return replace(form, slope=float(np.diff(far[:, 0])[0] / np.diff(heights)[0]))


def _middles(sections: Rows, heights: Array, move: Callable[[Array], Array]) -> Array:
    """(n, 2)  where the middles of a shaft's sections at heights are moved to"""
    rows = scaled(sections, 1.0)
    rows = rows[np.argsort(rows[:, 0])]
    middles = []
    for z in heights:
        half_x, half_y, y, x = (float(np.interp(z, rows[:, 0], rows[:, k])) for k in range(1, 5))
        places = move(ring(half_x, half_y, (x, y, z), SHAFT_POWER, _AROUND))[:, :2]
        middles.append((places.min(axis=0) + places.max(axis=0)) / 2)
    return np.array(middles)


def formed(points: Array, form: Form) -> Array:
    """(n, 3)  places of the mean man's bone in a person's, at the mean man's size, its shaft upright from the side

    points  (n, 3)  mm
    """
    beyond = np.maximum(form.end * points[:, 2] - _LEAN_TO_MM, 0.0)
    # Where the lattice ends its displacements stay the same; a shaft goes straight on.
    places = displaced(points - beyond[:, None] * [0.0, 0.0, form.end], form.lattice)
    places += beyond[:, None] * [*form.lean, form.end] + roughness(points, form.rough, form.seeds, form.end)
    places += growth(points, form.growth, form.grown_mm)
    return places @ form.upright().T


def eased(beyond_mm: Array) -> Array:
    """(n,)  distances beyond a place where a lean begins, 0 before it, with a smooth start"""
    beyond = np.maximum(beyond_mm, 0.0)
    return np.where(beyond < _EASE_MM, beyond**2 / (2 * _EASE_MM), beyond - _EASE_MM / 2)


def stand_femur(points: Array, build: Build) -> Array:
    """(n, 3)  places of the mean man's femur in this one: in its form, at its size, shaft leaning

    points  (n, 3)  mm
    """
    return formed_femur_stood(formed(points, build.femur), build)


def stand_tibia(points: Array, build: Build) -> Array:
    """(n, 3)  places of the mean man's tibia in this one: in its form, at its size, plateau falling, shaft leaning

    points  (n, 3)  mm
    """
    return formed_tibia_stood(formed(points, build.tibia), build)


def formed_femur_stood(places: Array, build: Build) -> Array:
    """(n, 3)  places of a femur, as `formed` gives them, at its size, shaft leaning; mm"""
    slope = -np.tan(np.deg2rad(build.femur_valgus_deg)) - build.femur.slope
    return _leaning(places * build.scale, build, build.shape.femur.shaft_pivot_z_mm, +1, slope)


def formed_tibia_stood(places: Array, build: Build) -> Array:
    """(n, 3)  places of a tibia, as `formed` gives them, at its size, plateau falling, shaft leaning; mm"""
    slope = np.tan(np.deg2rad(build.tibia_varus_deg)) - build.tibia.slope
    leant = sloped(places * build.scale, build)
    return _leaning(leant, build, build.shape.tibia.shaft_pivot_z_mm, -1, slope)


def _leaning(places: Array, build: Build, pivot_mm: float, end: int, slope: float) -> Array:
    places[:, 0] += slope * eased(end * (places[:, 2] - pivot_mm * build.scale))
    return places


def sloped(points_mm: Array, build: Build) -> Array:
    """(n, 3)  places of a tibia whose plateau falls backwards; below the tuberosity the shaft stays as it is

    points_mm  (n, 3)
    """
    places = points_mm.copy()
    fade = np.clip(1 + places[:, 2] / (_SLOPE_TO_MM * build.scale), 0.0, 1.0) ** 2
    places[:, 2] -= (np.tan(np.deg2rad(build.slope_deg)) - build.fall) * places[:, 1] * fade
    return places


def plateau_fall(form: Form, shape: TibiaShape) -> float:
    """By how much a person's plateau falls a millimetre backwards before it is sloped, mean of both sides."""
    x, y = np.repeat([_PLATEAU_X_MM, -_PLATEAU_X_MM], 2), np.tile([-_PLATEAU_Y_MM, _PLATEAU_Y_MM], 2)
    places = np.column_stack((x, y, plateau_height(x, y, shape.relief)))
    # Of this person's plateau at these places, not of where a form takes the mean man's.
    for _ in range(_PLATEAU_TURNS):
        places[:, :2] -= formed(places, form)[:, :2] - np.column_stack((x, y))
        places[:, 2] = plateau_height(places[:, 0], places[:, 1], shape.relief)
    heights = formed(places, form)[:, 2]
    return float(np.mean(heights[::2] - heights[1::2]) / (2 * _PLATEAU_Y_MM))


def scaled(sections: object, scale: float) -> Array:
    """(n, m)  a table of lengths, scaled"""
    return np.asarray(sections, dtype=np.float64) * scale
