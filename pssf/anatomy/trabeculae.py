"""trabeculae: a bone and a seed -> its trabecular density, seen alike under every protocol and pose.

BV/TV is a smooth mean m(x, y, z) times a lattice of struts around it, m (1 + g (lattice - 1)), where lattice >= 0 has
mean 1 and 0 <= g <= 1, so that it is never negative; the physeal scar adds to it. Density is that of such a mix of bone
and marrow.

lattice    the struts     integrate  integrals along segments
"""

from dataclasses import dataclass

import numpy as np
from msgspec import structs

from ..core.checks import Array, InputError, require, require_choice, require_seed
from ..data.records import Triple
from ..data.spongy import Ageing, Lattice, Scar, SpongyBone, TrabecularBone
from ..model.knee import Knee
from .integrate import Steps, integrate_density
from .joint import KneeAssembly
from .lattice import lattice, personal_factor
from .region import Region
from .rows import Struts

BONES = ("femur", "tibia", "fibula", "patella", "fabella")
# Spongy as another bone.
_AS = {"fabella": "patella"}
# Samples a voxel of the lattice, and samples over which the smooth part is taken as straight.
FINE, PIECE = 1, 10


@dataclass(frozen=True, kw_only=True)
class Trabeculae:
    """Relative density of the trabecular bone of one bone; a Density.

    region  its smooth part
    seed    of the lattice, which is made when it is first needed
    table   of the knee's lattice
    shift   where in the lattice (x, z, y, in voxels) the bone is
    into    rows of the (3, 4) transform from the knee frame into the bone's
    """

    region: Region
    seed: int
    table: Lattice
    shift: Triple
    into: tuple[float, ...]

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """(n,)  integral along straight segments (n, 3), mm; those of the parts of a segment add up to its own

        starts_mm, ends_mm  (n, 3)  knee frame
        """
        return self.sampled(starts_mm, ends_mm, FINE, PIECE)

    def sampled(self, starts_mm: Array, ends_mm: Array, fine: int, piece: int) -> Array:
        """(n,)  the same with `fine` samples a voxel, and the smooth part straight over `piece` samples

        starts_mm, ends_mm  (n, 3)  knee frame
        """
        out = np.empty(len(starts_mm))
        if not len(out):
            return out
        starts, ends = (np.ascontiguousarray(points, np.float64) for points in (starts_mm, ends_mm))
        block, unit = lattice(self.seed, self.table)
        x, z, y = self.table.voxel_mm
        struts = Struts(block.reshape(-1), self.table.voxels, unit, (1 / x, 1 / z, 1 / y), self.shift)
        into = np.array(self.into).reshape(3, 4)
        integrate_density(starts, ends, into, struts, self.region, Steps(fine, piece), out)
        return out


def trabeculae_of(knee: Knee, bone: str, table: TrabecularBone, assembly: KneeAssembly, frame: Array) -> "Trabeculae":
    """The trabecular density of one bone of a knee as it stands.

    frame  (3, 4)  transform in mm from the frame of the bone's trabeculae into that of the leg as it stands
    """
    return trabeculae(
        bone,
        table,
        seed=knee.texture_seed,
        scale=assembly.build.scale,
        frame=frame if assembly.turn is None else assembly.turn @ frame,
        mirror=assembly.mirror,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
        density=knee.bone_density,
        sclerotic_side=knee.sclerotic_side,
    )


def trabeculae(
    bone: str,
    table: TrabecularBone,
    *,
    seed: int,
    scale: float,
    frame: Array,
    mirror: Triple,
    sclerosis: float,
    age_years: float,
    sex: str,
    density: float,
    sclerotic_side: str = "medial",
) -> Trabeculae:
    """The trabecular density of one bone of a knee.

    table           how much spongy bone there is where, and its lattice
    seed            of the knee's texture; its bones take different parts of one lattice
    scale           size of the bone over the mean man's; struts keep their own size
    frame           (3, 4)  rigid transform from the bone's frame to that of a right knee, mm
    mirror          (x, y, z) factors of 1 or -1 by which that knee is mirrored, as a left one is in x
    sclerosis       thickness of the subchondral plate over a healthy one's (`Knee.subchondral_plate`)
    density         of a person over others of that age and sex (`Knee.bone_density`)
    sclerotic_side  medial or lateral: which has more of the sclerosis (`Knee.sclerotic_side`)
    raises          InputError for an unknown bone, mirror, sex or side, a value out of range, a frame that is not rigid
    """
    require_choice("bone", bone, BONES)
    require_choice("sex", sex, ("male", "female"))
    require_choice("sclerotic_side", sclerotic_side, ("medial", "lateral"))
    require_seed(seed)
    require("scale", scale, 0.5, 2.0, "(relative)")
    require("sclerosis", sclerosis, 0.5, 2.5, "(relative)")
    require("age_years", age_years, 18, 100, "years")
    require("density", density, 0.4, 1.8, "(relative)")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 + BONES.index(bone),)))
    x, z, y = (rng.random(3) * table.lattice.voxels).tolist()
    aged = _aged(table.ageing, age_years, sex, density)
    return Trabeculae(
        region=_region(bone, table, rng.random(7).tolist(), scale, (sclerosis, sclerotic_side), aged),
        seed=int(seed),
        table=_grained(table, int(seed), sclerosis, age_years, sex),
        shift=(x, z, y),
        into=_inverse(np.asarray(frame, np.float64), mirror),
    )


def healthy_tibia(table: TrabecularBone, *, seed: int) -> Trabeculae:
    """That of the tibia of a healthy man of 55 years and mean size, in the bone's own frame; arguments as above."""
    return trabeculae(
        "tibia",
        table,
        seed=seed,
        scale=1.0,
        frame=np.eye(3, 4),
        mirror=(1.0, 1.0, 1.0),
        sclerosis=1.0,
        age_years=55.0,
        sex="male",
        density=1.0,
    )


def make_struts(table: TrabecularBone, *, seed: int, sclerosis: float, age_years: float, sex: str) -> None:
    """Make the lattice of a knee's bones now, as `trabeculae` has it, so that integrals find it made."""
    lattice(int(seed), _grained(table, int(seed), sclerosis, age_years, sex))


def _region(
    bone: str,
    table: TrabecularBone,
    chance: list[float],
    scale: float,
    sclerotic: tuple[float, str],
    aged: tuple[float, float],
) -> Region:
    """The smooth part of a bone.

    chance     uniform numbers: of the scar height, lateral strength, place across, place front to back, ripple; of the
               sway; of the scar medial strength
    sclerotic  thickness of the plate over a healthy one's, and the side that has more of what that adds
    aged       BV/TV and contrast of the struts over those of the table
    """
    sclerosis, side = sclerotic
    part, hard, tissue = getattr(table, _AS.get(bone, bone)), table.sclerosis, table.tissue
    excess = part.sclerosis * hard.per_plate * (sclerosis - 1)
    # A plate thinner than a healthy one takes no more than its own rise.
    shares = (1.0, hard.other_side_deep) if side == "medial" else (hard.other_side_deep, 1.0)
    added = [max(-part.plate, (1 + part.plate) * excess * share) for share in shares]
    left, contrast = aged
    contrast /= 1 + hard.fills_per_plate * (sclerosis - 1)
    same = {name: value for name in Region._fields if isinstance(value := getattr(part, name, None), float)}
    same |= {name: min(1.0, getattr(part, name) * contrast) for name in ("gain", "gain_shaft")}
    same |= _inverse_lengths(part)
    dips = [(x, 1 / half, rise) for x, half, rise in part.dips]
    return Region(
        **same,
        **_scar(part, table.scar, chance),
        middle_mm=table.side.middle_mm,
        hard_medial=added[0],
        hard_lateral=added[1],
        hard_per_mm=1 / hard.deep_mm if excess > 0 else 1 / part.plate_mm,
        joint=part.joint,
        dips=(dips[0], dips[1], dips[2]),
        sway_mm=table.sway.aside_mm,
        sway_per_mm=2 * np.pi / table.sway.length_mm,
        sway_across=table.sway.across,
        sway_phase=2 * np.pi * chance[5],
        scale=float(scale),
        per_scale=1 / scale,
        marrow=tissue.marrow,
        per_bvtv=left * (1 - tissue.marrow) / tissue.bvtv,
    )


def _scar(part: SpongyBone, scar: Scar, chance: list[float]) -> dict[str, float]:
    """Fields of `Region`: where a bone's physeal scar is and how strong on either side; `chance` as of `_region`."""
    lateral, medial = (scar.least + (1 - scar.least) * chance[n] for n in (1, 6))
    return {
        "scar_lateral": part.scar_sides[0] * lateral,
        "scar_medial": part.scar_sides[1] * medial,
        "scar_off_mm": scar.off_mm[0] + (scar.off_mm[1] - scar.off_mm[0]) * chance[2],
        "scar_y": scar.dome_off_mm * (2 * chance[3] - 1),
        "scar_z": part.scar_mm[0] + (part.scar_mm[1] - part.scar_mm[0]) * chance[0],
        "scar_wide_per_mm": 1 / scar.wide_mm,
        "scar_ripple_mm": scar.ripple_mm,
        "scar_ripple_per_mm": 2 * np.pi / scar.ripple_length_mm,
        "scar_phase": 2 * np.pi * chance[4],
    }


def _inverse_lengths(part: SpongyBone) -> dict[str, float]:
    halves = ("between", "column", "margin", "rim", "scar", "struts")
    lengths = {name: f"{name}_mm" for name in ("fade", "plate")} | {name: f"{name}_half_mm" for name in halves}
    return {f"{name}_per_mm": 1 / getattr(part, field) for name, field in lengths.items()}


def _aged(ageing: Ageing, age_years: float, sex: str, density: float) -> tuple[float, float]:
    """BV/TV and contrast of the struts of a person over those of the table."""
    years = age_years - ageing.reference_years
    return density * (1 - ageing.per_year * years) * ageing.mean[sex], 1 + ageing.contrast_per_year[sex] * years


def _grained(table: TrabecularBone, seed: int, sclerosis: float, age_years: float, sex: str) -> Lattice:
    """The lattice of one knee: where its struts are stays as it is, how fine they are does not."""
    grain, years = table.grain, age_years - table.ageing.reference_years
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 + len(BONES),)))
    coarse = (
        personal_factor(grain.deviation, rng)
        * (1 + grain.per_year[sex] * years)
        * (1 + grain.per_plate * (sclerosis - 1))
    )
    return structs.replace(table.lattice, high_per_mm=table.lattice.high_per_mm / coarse)


def _inverse(frame: Array, mirror: Triple) -> tuple[float, ...]:
    """From the knee frame into the bone's, (3, 4) row by row."""
    turn = frame[:, :3]
    if frame.shape != (3, 4) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise InputError(f"frame = {frame.tolist()}; allowed: a rotation and a shift, (3, 4)")
    if len(mirror) != 3 or not set(mirror) <= {-1.0, 1.0}:
        raise InputError(f"mirror = {mirror!r}; allowed: three factors of 1 or -1")
    flip = np.diag(mirror)
    return tuple(np.column_stack((turn.T @ flip, -turn.T @ frame[:, 3])).ravel().tolist())
