"""Trabecular density of each bone, computed from a texture seed and independent of protocol and pose.

BV/TV is m (1 + g (lattice - 1)), plus the physeal scar. In this formula, m(x, y, z) is the smooth mean, and g is the
strut contrast. The strut lattice is non-negative and has mean 1. With 0 <= g <= 1, BV/TV is never negative. Relative
density is the density of the mixture of bone and marrow, divided by the tabulated density of trabecular bone.
"""

from dataclasses import dataclass

import numpy as np
from msgspec import structs

from ...core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
    require_seed,
)
from ...data.anatomy.trabecular_table import (
    Ageing,
    PhysealScar,
    StrutLattice,
    TrabecularBone,
    TrabecularDensityProfile,
)
from ...data.table_records import Triple
from .density_integral import SamplingSteps, integrate_density
from .density_region import DensityParameters
from .segment_rows import StrutVoxels
from .strut_lattice import make_strut_lattice, sample_personal_factor

BONES = ("femur", "tibia", "fibula", "patella", "fabella")
# Bones that use the density profile of another bone.
_DENSITY_SOURCE_BONE = {"fabella": "patella"}
# Samples per voxel of the lattice.
FINE = 1
# Samples per interval of a segment. The smooth density component is linear within an interval.
PIECE = 10


@dataclass(frozen=True, kw_only=True)
class Trabeculae:
    """Relative trabecular density of one bone; implements `Density`.

    Attributes
    ----------
    density_parameters : DensityParameters
        Parameters of the smooth density component.
    seed : int
        Seed of the strut lattice, which is made at first use.
    lattice_table : StrutLattice
        Parameters of the strut lattice of this knee.
    shift : (float, float, float)
        Position of the bone in the lattice along x, z and y, in voxels.
    knee_to_bone : tuple of 12 float
        Transform (3, 4) from the knee frame to the frame of the bone, in row-major order, in mm.
    """

    density_parameters: DensityParameters
    seed: int
    lattice_table: StrutLattice
    shift: Triple
    knee_to_bone: tuple[float, ...]

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """Integrate relative density along straight segments.

        Parameters
        ----------
        starts_mm : (n, 3) float64 array
            Start points in the knee frame, in mm.
        ends_mm : (n, 3) float64 array
            End points in the knee frame, in mm.

        Returns
        -------
        (n,) float64 array
            Integrals in mm. The integrals over consecutive parts of a segment add up to the integral over the entire
            segment.
        """
        return self.integrate_with_steps(starts_mm, ends_mm, FINE, PIECE)

    def integrate_with_steps(self, starts_mm: Array, ends_mm: Array, fine: int, piece: int) -> Array:
        """Integrate relative density along straight segments with a specified number of samples.

        Parameters
        ----------
        starts_mm : (n, 3) float64 array
            Start points in the knee frame, in mm.
        ends_mm : (n, 3) float64 array
            End points in the knee frame, in mm.
        fine : int
            Samples per voxel of the lattice.
        piece : int
            Samples per interval of a segment. The smooth density component is linear within an interval.

        Returns
        -------
        (n,) float64 array
            Integrals in mm.
        """
        out = np.empty(len(starts_mm))
        if not len(out):
            return out
        starts, ends = (np.ascontiguousarray(points, np.float64) for points in (starts_mm, ends_mm))
        block, unit = make_strut_lattice(self.seed, self.lattice_table)
        x, z, y = self.lattice_table.voxel_mm
        struts = StrutVoxels(block.reshape(-1), self.lattice_table.voxels, unit, (1 / x, 1 / z, 1 / y), self.shift)
        into = np.array(self.knee_to_bone).reshape(3, 4)
        integrate_density(starts, ends, into, struts, self.density_parameters, SamplingSteps(fine, piece), out)
        return out


def build_trabeculae(
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
    """Build the trabecular density of one bone of a knee.

    Parameters
    ----------
    bone : str
        "femur", "tibia", "fibula", "patella" or "fabella".
    table : TrabecularBone
        Distribution of trabecular bone and parameters of the strut lattice.
    seed : int
        Texture seed of the knee. The bones of a knee use different portions of one lattice.
    scale : float
        Size of the bone relative to the template, from 0.5 to 2. The size of the struts does not depend on it.
    frame : (3, 4) float64 array, mm
        Rigid transform from the frame of the bone to the frame of a right knee.
    mirror : (float, float, float)
        Factors of +1 or -1 by which the right knee is mirrored along x, y and z. A left knee is mirrored along x.
    sclerosis : float
        Thickness of the subchondral bone plate relative to a healthy plate, from 0.5 to 2.5 (`Knee.subchondral_plate`).
    age_years : float
        Age, from 18 to 100 years.
    sex : str
        "male" or "female".
    density : float
        Density relative to the mean for the age and sex, from 0.4 to 1.8 (`Knee.bone_density`).
    sclerotic_side : str
        "medial" or "lateral": compartment with more sclerosis (`Knee.sclerotic_side`).

    Returns
    -------
    Trabeculae
        Trabecular density of the bone.

    Raises
    ------
    InputError
        If the bone, sex, side or mirror is unknown, if a value is out of range, or if the frame is not rigid.
    """
    require_choice("bone", bone, BONES)
    require_choice("sex", sex, ("male", "female"))
    require_choice("sclerotic_side", sclerotic_side, ("medial", "lateral"))
    require_seed(seed)
    require_in_range("scale", scale, 0.5, 2.0, "(relative)")
    require_in_range("sclerosis", sclerosis, 0.5, 2.5, "(relative)")
    require_in_range("age_years", age_years, 18, 100, "years")
    require_in_range("density", density, 0.4, 1.8, "(relative)")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 + BONES.index(bone),)))
    x, z, y = (rng.random(3) * table.lattice.voxels).tolist()
    aged = _compute_age_factors(table.ageing, age_years, sex, density)
    return Trabeculae(
        density_parameters=_resolve_density_parameters(
            bone, table, rng.random(7).tolist(), scale, (sclerosis, sclerotic_side), aged
        ),
        seed=int(seed),
        lattice_table=_personalise_lattice(table, int(seed), sclerosis, age_years, sex),
        shift=(x, z, y),
        knee_to_bone=_invert_transform(np.asarray(frame, np.float64), mirror),
    )


def build_healthy_tibia_trabeculae(table: TrabecularBone, *, seed: int) -> Trabeculae:
    """Build the trabecular density of a healthy male tibia at template size and an age of 55 years.

    The density is in the frame of the tibia.

    Parameters
    ----------
    table : TrabecularBone
        Distribution of trabecular bone and parameters of the strut lattice.
    seed : int
        Texture seed.

    Returns
    -------
    Trabeculae
        Trabecular density of the tibia.

    Raises
    ------
    InputError
        If the seed is out of range.
    """
    return build_trabeculae(
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
    """Make and cache the strut lattice of a knee, so that later integrals can use it.

    Parameters
    ----------
    table : TrabecularBone
        Distribution of trabecular bone and parameters of the strut lattice.
    seed : int
        Texture seed of the knee.
    sclerosis : float
        Thickness of the subchondral bone plate relative to a healthy plate.
    age_years : float
        Age in years.
    sex : str
        "male" or "female".
    """
    make_strut_lattice(int(seed), _personalise_lattice(table, int(seed), sclerosis, age_years, sex))


def _resolve_density_parameters(
    bone: str,
    table: TrabecularBone,
    uniform_samples: list[float],
    scale: float,
    sclerosis_and_side: tuple[float, str],
    age_factors: tuple[float, float],
) -> DensityParameters:
    """Compute the parameters of the smooth density component of a bone.

    `uniform_samples` are seven numbers from 0 to 1. Numbers 1 to 5 set the physeal scar: height, lateral strength,
    position along x, position along y, and phase of the ripple. Number 6 sets the phase of the sideways waviness of the
    struts. Number 7 sets the medial strength of the scar. `sclerosis_and_side` is the relative thickness of the
    subchondral bone plate and the more sclerotic compartment. `age_factors` multiply BV/TV and strut contrast.
    """
    sclerosis, side = sclerosis_and_side
    part, hard, tissue = getattr(table, _DENSITY_SOURCE_BONE.get(bone, bone)), table.sclerosis, table.tissue
    excess = part.sclerosis * hard.per_plate * (sclerosis - 1)
    # A plate thinner than a healthy plate reduces BV/TV by at most the increase that a healthy plate causes.
    shares = (1.0, hard.other_side_deep) if side == "medial" else (hard.other_side_deep, 1.0)
    added = [max(-part.plate, (1 + part.plate) * excess * share) for share in shares]
    left, contrast = age_factors
    contrast /= 1 + hard.fills_per_plate * (sclerosis - 1)
    same = {name: value for name in DensityParameters._fields if isinstance(value := getattr(part, name, None), float)}
    same |= {name: min(1.0, getattr(part, name) * contrast) for name in ("gain", "gain_shaft")}
    same |= _invert_lengths(part)
    dips = [(x, 1 / half, rise) for x, half, rise in part.dips]
    return DensityParameters(
        **same,
        **_resolve_scar_parameters(part, table.scar, uniform_samples),
        middle_mm=table.side.middle_mm,
        hard_medial=added[0],
        hard_lateral=added[1],
        hard_per_mm=1 / hard.deep_mm if excess > 0 else 1 / part.plate_mm,
        joint=part.joint,
        dips=(dips[0], dips[1], dips[2]),
        sway_mm=table.sway.amplitude_mm,
        sway_per_mm=2 * np.pi / table.sway.length_mm,
        sway_across=table.sway.across,
        sway_phase=2 * np.pi * uniform_samples[5],
        scale=float(scale),
        per_scale=1 / scale,
        marrow=tissue.marrow,
        per_bvtv=left * (1 - tissue.marrow) / tissue.bvtv,
    )


def _resolve_scar_parameters(
    part: TrabecularDensityProfile, scar: PhysealScar, uniform_samples: list[float]
) -> dict[str, float]:
    """Compute the fields of `DensityParameters` for the position and strength of the physeal scar.

    `uniform_samples` are described in `_resolve_density_parameters`.
    """
    lateral, medial = (scar.least + (1 - scar.least) * uniform_samples[n] for n in (1, 6))
    return {
        "scar_lateral": part.scar_sides[0] * lateral,
        "scar_medial": part.scar_sides[1] * medial,
        "scar_off_mm": scar.off_mm[0] + (scar.off_mm[1] - scar.off_mm[0]) * uniform_samples[2],
        "scar_y": scar.dome_off_mm * (2 * uniform_samples[3] - 1),
        "scar_z": part.scar_mm[0] + (part.scar_mm[1] - part.scar_mm[0]) * uniform_samples[0],
        "scar_wide_per_mm": 1 / scar.wide_mm,
        "scar_ripple_mm": scar.ripple_mm,
        "scar_ripple_per_mm": 2 * np.pi / scar.ripple_length_mm,
        "scar_phase": 2 * np.pi * uniform_samples[4],
    }


def _invert_lengths(part: TrabecularDensityProfile) -> dict[str, float]:
    """Compute the inverse lengths in `DensityParameters` from a density profile, in 1/mm."""
    halves = ("between", "column", "margin", "rim", "scar", "struts")
    lengths = {name: f"{name}_mm" for name in ("fade", "plate")} | {name: f"{name}_half_mm" for name in halves}
    return {f"{name}_per_mm": 1 / getattr(part, field) for name, field in lengths.items()}


def _compute_age_factors(ageing: Ageing, age_years: float, sex: str, density: float) -> tuple[float, float]:
    """Compute the factors by which age, sex and individual density change BV/TV and strut contrast."""
    years = age_years - ageing.reference_years
    return density * (1 - ageing.per_year * years) * ageing.mean[sex], 1 + ageing.contrast_per_year[sex] * years


def _personalise_lattice(
    table: TrabecularBone, seed: int, sclerosis: float, age_years: float, sex: str
) -> StrutLattice:
    """Adjust the coarseness of the struts to one knee, without changing strut positions."""
    grain, years = table.grain, age_years - table.ageing.reference_years
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 + len(BONES),)))
    coarse = (
        sample_personal_factor(grain.deviation, rng)
        * (1 + grain.per_year[sex] * years)
        * (1 + grain.per_plate * (sclerosis - 1))
    )
    return structs.replace(table.lattice, high_per_mm=table.lattice.high_per_mm / coarse)


def _invert_transform(frame: Array, mirror: Triple) -> tuple[float, ...]:
    """Invert a rigid transform (3, 4) and a mirroring.

    The result maps the knee frame to the bone frame, in row-major order.
    """
    turn = frame[:, :3]
    if frame.shape != (3, 4) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise InputError(f"frame must be a rotation and a translation as a (3, 4) array, got {frame.tolist()}")
    if len(mirror) != 3 or not set(mirror) <= {-1.0, 1.0}:
        raise InputError(f"mirror must be three factors, each 1 or -1, got {mirror!r}")
    flip = np.diag(mirror)
    return tuple(np.column_stack((turn.T @ flip, -turn.T @ frame[:, 3])).ravel().tolist())
