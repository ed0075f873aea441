"""Check trabecular bone: density integrals, strut lattice, sclerosis, age, and physeal scar."""

import dataclasses
import time
from concurrent.futures import ThreadPoolExecutor

import msgspec
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import pssf
from pssf import InputError
from pssf.anatomy.trabeculae import strut_lattice as struts
from pssf.anatomy.trabeculae.trabecular_density import BONES, Trabeculae, build_trabeculae
from pssf.data import data_files
from pssf.data.anatomy.trabecular_table import load_trabecular_bone
from pssf.geometry.density import Density
from pssf.geometry.view import View

HEALTHY = dict(
    seed=3,
    scale=1.0,
    frame=np.eye(3, 4),
    mirror=(1.0, 1.0, 1.0),
    sclerosis=1.0,
    age_years=55.0,
    sex="male",
    density=1.0,
)
FLAT = dict(
    margin_per_mm=0.0,
    rim=0.0,
    shaft=0.15,
    bvtv=0.15,
    medial=0.0,
    load=0.0,
    plate=0.0,
    hard_medial=0.0,
    hard_lateral=0.0,
    strut_convergence=0.0,
    scar_bvtv=0.0,
)
NO_STRUTS = dict(gain=0.0, gain_shaft=0.0)
EVEN = dict(FLAT, gain=1.0, gain_load=0.0, gain_shaft=1.0, sway_mm=0.0)


def build_bone(name: str = "tibia", **changed) -> Trabeculae:
    return build_trabeculae(name, load_trabecular_bone(), **{**HEALTHY, **changed})


def change_parameters(density: Trabeculae, **changed) -> Trabeculae:
    return dataclasses.replace(density, density_parameters=density.density_parameters._replace(**changed))


def sample_segments(count: int, seed: int = 0, spread_mm: float = 40.0) -> np.ndarray:
    """Sample starts and ends of segments in random directions, as (2, count, 3)."""
    return np.random.default_rng(seed).normal(size=(2, count, 3)) * spread_mm


def make_segments_along_y(x_mm, z_mm, half_mm: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """Make segments along y through points (x, z)."""
    x, z = np.broadcast_arrays(np.asarray(x_mm, float).ravel(), np.asarray(z_mm, float).ravel())
    return np.column_stack((x, x * 0 - half_mm, z)), np.column_stack((x, x * 0 + half_mm, z))


def compute_bvtv(density: Trabeculae, x_mm, z_mm, half_mm: float = 20.0) -> float:
    """Compute the mean BV/TV along y at points (x, z) for a man of 55 years."""
    starts, ends = make_segments_along_y(x_mm, z_mm, half_mm)
    tissue = data_files.load_data_table("trabeculae")["tissue"]
    mean = density.integrate(starts, ends).mean() / (2 * half_mm)
    return (mean - tissue["marrow"]) / (1 - tissue["marrow"]) * tissue["bvtv"]


def make_rotation(degrees: float) -> np.ndarray:
    """Make a rotation about an oblique axis."""
    return trimesh.transformations.rotation_matrix(np.deg2rad(degrees), (1.0, 2.0, -0.5))[:3, :3]


# Positions x across the points at which bone density is measured, and heights z below the middle of the plateau, in mm.
ACROSS_MM = np.linspace(-4, 4, 30)
DEEP_MM = np.arange(-22, -6, 3)
SCAR_ORDER = {"femur": (-1, 1, 0), "tibia": (1, -1, 0)}


@pytest.fixture(scope="module")
def means_of_24_seeds() -> dict[str, np.ndarray]:
    """Average BV/TV and scar integrals over 24 seeds, because they vary between seeds."""
    # The floor of the medial plateau is about 3 mm below the plateau edges, whose height is 0.
    sides = [(ACROSS_MM + at, z, 12.0) for at in (23.0, -23.0) for z in (-7.0, -11.0, -18.0)]
    points = [*sides, *((ACROSS_MM + 23, z, 22.5) for z in DEEP_MM)]
    found: dict[str, list] = {"bvtv": [], "femur": [], "tibia": []}
    for seed in range(24):
        found["bvtv"].append([compute_bvtv(build_bone(seed=seed), *point) for point in points])
        for name, order in SCAR_ORDER.items():
            found[name].append(_integrate_scar(build_bone(name, seed=seed), np.array(order)))
    return {name: np.mean(values, axis=0) for name, values in found.items()}


@pytest.fixture(scope="module")
def patch() -> np.ndarray:
    """Integrate uniform trabecular bone over 40 mm along y, (128, 128) pixels of 0.15 mm; rows start proximally."""
    x, z = np.meshgrid(np.arange(128) * 0.15 + 13, -np.arange(128) * 0.15 - 6)
    return change_parameters(build_bone(), **EVEN).integrate(*make_segments_along_y(x, z)).reshape(x.shape)


def test_the_integral_of_uniform_bone_without_struts_is_its_length():
    starts, ends = sample_segments(500)
    length = np.linalg.norm(ends - starts, axis=1)
    even = change_parameters(build_bone(), **FLAT, **NO_STRUTS)
    assert_allclose(even.integrate(starts, ends), length, rtol=1e-12)
    assert_allclose(
        change_parameters(even, marrow=0.0).integrate(starts, ends),
        length * (1 - even.density_parameters.marrow),
        rtol=1e-12,
    )


def test_segments_of_zero_length_have_an_integral_of_zero():
    starts, _ = sample_segments(3)
    assert build_bone().integrate(starts, starts).tolist() == [0.0, 0.0, 0.0]
    assert build_bone().integrate(starts[:0], starts[:0]).shape == (0,)
    assert isinstance(build_bone(), Density)


@pytest.mark.parametrize("name", BONES)
@pytest.mark.parametrize("along_y", [0.0, 1.0])
def test_integrals_over_parts_of_a_segment_sum_to_the_total_integral(name, along_y):
    starts, ends = sample_segments(300)
    # Segments within a few degrees of y and in other directions are sampled differently; both cases are tested.
    ends = ends + along_y * (starts + np.array([0.0, 60.0, 0.0]) - ends) + along_y * sample_segments(300, 2, 1.0)[0]
    fraction = np.random.default_rng(1).random((300, 1))
    middles = starts + fraction * (ends - starts)
    density = build_bone(name)
    parts = density.integrate(starts, middles) + density.integrate(middles, ends)
    assert_allclose(parts, density.integrate(starts, ends), atol=1e-9)


def test_a_reversed_segment_has_the_same_integral():
    starts, ends = sample_segments(300)
    assert_allclose(build_bone().integrate(starts, ends), build_bone().integrate(ends, starts), rtol=1e-9)


@pytest.mark.parametrize("oblique", [0.0, 20.0])
def test_the_integral_of_a_segment_does_not_depend_on_its_neighbours(oblique):
    # Segments are processed in parallel; the test includes zero length, and directions along y and oblique to y.
    starts, ends = sample_segments(37)
    ends = starts + np.array([0.0, 1.0, 0.0]) * (ends - starts) + oblique * sample_segments(37, 2, 1.0)[0]
    ends[5] = starts[5]
    together = build_bone().integrate(starts, ends)
    for order in (np.arange(37)[::-1], np.random.default_rng(4).permutation(37)):
        assert np.array_equal(build_bone().integrate(starts[order], ends[order]), together[order])
    alone = [build_bone().integrate(starts[[k]], ends[[k]])[0] for k in range(37)]
    assert np.array_equal(alone, together)


def test_the_seed_determines_the_trabecular_structure():
    starts, ends = make_segments_along_y(np.linspace(-30, 30, 400), -12.0)
    first, again, other = (build_bone(seed=seed) for seed in (5, 5, 6))
    assert first == again
    assert first != other
    one, two, three = (density.integrate(starts, ends) for density in (first, other, again))
    assert np.array_equal(one, three)
    assert abs(np.corrcoef(one - np.convolve(one, np.ones(40) / 40, "same"), two)[0, 1]) < 0.3


def test_tibia_and_femur_have_different_struts():
    starts, ends = make_segments_along_y(np.linspace(-30, 30, 400), -12.0)
    one, two = (change_parameters(build_bone(name), **EVEN).integrate(starts, ends) for name in ("tibia", "femur"))
    assert one.std() > 0.3
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.3


def test_moving_bone_and_segments_together_preserves_integrals():
    starts, ends = sample_segments(300)
    matrix, shift = make_rotation(37.0), np.array([3.0, -11.0, 25.0])
    moved = build_bone(frame=np.column_stack((matrix, shift)))
    found = moved.integrate(starts @ matrix.T + shift, ends @ matrix.T + shift)
    assert_allclose(found, build_bone().integrate(starts, ends), rtol=1e-9)
    assert np.abs(moved.integrate(starts, ends) / found - 1).max() > 0.01


def test_trabeculae_of_a_left_knee_mirror_those_of_a_right_knee():
    starts, ends = sample_segments(300)
    frame, flip = np.column_stack((make_rotation(8.0), (2.0, 1.0, -4.0))), np.array([-1.0, 1.0, 1.0])
    right, left = (build_bone(frame=frame, mirror=(x, 1.0, 1.0)) for x in (1.0, -1.0))
    assert_allclose(left.integrate(starts * flip, ends * flip), right.integrate(starts, ends), rtol=1e-9)
    assert np.abs(left.integrate(starts, ends) / right.integrate(starts, ends) - 1).max() > 0.01


@pytest.mark.parametrize("name", BONES)
def test_density_reaches_that_of_marrow_but_is_never_lower(name):
    rng = np.random.default_rng(0)
    starts = rng.uniform(-60, 60, (20_000, 3))
    ends = starts + rng.normal(size=starts.shape) * 0.02
    density = build_bone(name, sclerosis=2.5, age_years=20.0)
    thin = build_bone(name, sclerosis=0.5)
    assert (
        thin.integrate(starts, ends)
        >= thin.density_parameters.marrow * np.linalg.norm(ends - starts, axis=1) * (1 - 1e-12)
    ).all()
    found = density.integrate(starts, ends) / np.linalg.norm(ends - starts, axis=1)
    assert found.min() >= density.density_parameters.marrow * (1 - 1e-12)
    assert found.min() < density.density_parameters.marrow + {
        "patella": 0.25,
        "fabella": 0.25,
        "femur": 0.15,
        "fibula": 0.1,
    }.get(name, 0.05)
    assert found.max() > 1.5


def test_a_lattice_with_hard_edges_is_made_without_overflow():
    table = msgspec.structs.replace(load_trabecular_bone().lattice, voxels=(32, 32, 16), waves_y=8, softness=0.01)
    with np.errstate(over="raise"):
        block, _ = struts.make_strut_lattice(3, table)
    assert block.min() == 0
    assert block.max() == 255


def test_the_strut_lattice_is_periodic_with_the_specified_bone_fraction():
    block, unit = struts.make_strut_lattice(3, load_trabecular_bone().lattice)
    assert block.shape == (513, 257, 128)
    assert np.array_equal(block[-1], block[0])
    assert np.array_equal(block[:, -1], block[:, 0])
    block = block[:-1, :-1]
    assert_allclose(block.mean() * unit, 1.0, rtol=1e-12)
    assert 0.08 < (block > 127).mean() < 0.18  # BV/TV of metaphyses in the reference list: 0.08 to 0.20
    even = change_parameters(build_bone(), **EVEN)
    starts, ends = make_segments_along_y(np.linspace(-20, 20, 200), -12.0)
    for period_mm in ((81.92, 0.0, 0.0), (0.0, 64.0, 0.0), (0.0, 0.0, 51.2)):
        assert_allclose(even.integrate(starts + period_mm, ends + period_mm), even.integrate(starts, ends), rtol=1e-6)
    assert np.abs(even.integrate(starts + 20.0, ends + 20.0) / even.integrate(starts, ends) - 1).max() > 0.01


def test_the_lattice_is_created_once_on_demand_and_cached_for_two_knees(monkeypatch):
    made = []

    def make(seed, table):
        made.append(seed)
        # The delay allows a second thread to request the lattice.
        time.sleep(0.05)
        block = np.zeros((513, 257, 128), np.uint8)
        block.setflags(write=False)
        return block, 1.0

    monkeypatch.setattr(struts, "_synthesise_lattice", make)
    monkeypatch.setattr(struts, "_CACHE", {})
    density, ends = build_bone(seed=11), sample_segments(10)
    density.integrate(*sample_segments(0))
    assert made == []
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: density.integrate(*ends), range(8)))
    build_bone("femur", seed=11).integrate(*ends)
    assert made == [11]
    build_bone(seed=12).integrate(*ends)
    density.integrate(*ends)
    assert made == [11, 12]
    build_bone(seed=13).integrate(*ends)
    assert made == [11, 12, 13]
    assert [seed for seed, _ in struts._CACHE] == [12, 13]


def test_projected_struts_are_vertical_fine_and_nearly_gaussian(patch):
    from numpy.fft import fft2, fftfreq

    flat = patch - patch.mean()
    assert 0.02 < flat.std() / patch.mean() < 0.12
    z = flat / flat.std()
    assert abs((z**3).mean()) < 0.6
    assert -0.5 < (z**4).mean() - 3 < 1.0
    window = np.hanning(128)[:, None] * np.hanning(128)
    power = np.abs(fft2(flat * window)) ** 2
    fx, fz = np.meshgrid(fftfreq(128, 0.15), fftfreq(128, 0.15))
    radius, angle = np.hypot(fx, fz), np.degrees(np.arctan2(np.abs(fz), np.abs(fx)))
    band = (radius > 0.3 * 1.21) & (radius < 1.5 * 1.21)
    assert 1.7 < power[band & (angle < 30)].mean() / power[band & (angle > 60)].mean() < 6
    low, middle, high = (power[(radius > f / 1.2) & (radius < f * 1.2)].mean() for f in (0.4, 1.0, 2.4))
    # The spectrum is flat up to the strut spacing and steep above; detector blur adds 2 to the second slope.
    assert -1.8 < np.log(middle / low) / np.log(1.0 / 0.4) < 0.2
    assert -3.5 < np.log(high / middle) / np.log(2.4) < -1.2


def test_trabecular_bone_is_densest_below_the_medial_plateau(means_of_24_seeds):
    medial, lateral, metaphysis = np.split(means_of_24_seeds["bvtv"], (3, 6))
    assert medial[0] > 1.15 * medial[1] > 1.15 * medial[2]
    # Medial exceeds lateral over the first 6 mm (J Orthop Res 2003 21:6); at 8 to 28 mm patient tibiae are slightly
    # brighter laterally (trabeculae.toml), and the physeal scar with its random side is there.
    assert medial[0] > 1.1 * lateral[0]
    assert medial[1] > lateral[1]
    assert 0.9 < medial[2] / lateral[2] < 1.1
    assert 0.18 < medial[0] < 0.37
    assert 0.08 < medial[2] < 0.22
    assert compute_bvtv(build_bone(), ACROSS_MM, -120.0) < 0.05
    assert 0.7 < 1.083 * 4.5 * metaphysis.mean() < 1.15
    wavy, calm = (
        build_bone().integrate(*make_segments_along_y(np.linspace(-8, 8, 200), z)).std() for z in (-30.0, -130.0)
    )
    assert calm < 0.2 * wavy


def test_sclerosis_increases_subchondral_density_mainly_medially():
    # Struts are disabled, because sclerosis also makes them coarser.
    x, healthy, hard = (
        np.linspace(-4, 4, 30),
        *(change_parameters(build_bone(sclerosis=of), **NO_STRUTS) for of in (1.0, 1.78)),
    )
    rise = {
        (at, z): compute_bvtv(hard, x + at, z) / compute_bvtv(healthy, x + at, z)
        for at in (23.0, -23.0)
        for z in (-5.5, -80.0)
    }
    assert 1.25 < rise[23.0, -5.5] < 1.47  # Rapagna 2021: 1.47 directly below the subchondral plate
    # On patient radiographs with KL grade 3 or 4, the tibia is brighter on both sides (trabeculae.toml).
    assert 1.1 < rise[-23.0, -5.5] < rise[23.0, -5.5]
    assert all(1.0 <= rise[at, -80.0] < 1.02 for at in (23.0, -23.0))
    # Sclerosis extends deeper than the normal increase below the plateau.
    below = {
        name: compute_bvtv(bone_of, x + 23.0, -12.0) / compute_bvtv(bone_of, x + 23.0, -5.5)
        for name, bone_of in (("healthy", healthy), ("hard", hard))
    }
    assert below["hard"] > below["healthy"]
    # Sclerosis reduces the strut contrast in the entire knee; other parameters of the fibula do not change.
    fibula, filled = (build_bone("fibula", sclerosis=of).density_parameters for of in (1.0, 1.78))
    assert filled.gain < 0.85 * fibula.gain
    assert filled._replace(gain=fibula.gain, gain_shaft=fibula.gain_shaft) == fibula


def test_struts_are_coarser_in_sclerotic_bone_and_in_old_women():
    def get_finest_frequency(**changed) -> float:
        return build_bone(**changed).lattice_table.high_per_mm

    assert get_finest_frequency(sclerosis=1.5) < get_finest_frequency() / 1.1
    assert get_finest_frequency(sex="female", age_years=90.0) < get_finest_frequency(sex="female", age_years=20.0)
    assert build_bone("femur", sclerosis=1.5).lattice_table == build_bone(sclerosis=1.5).lattice_table
    assert len({get_finest_frequency(seed=seed) for seed in range(20)}) > 15
    starts, ends = make_segments_along_y(np.linspace(-20, 20, 400), -12.0)
    fine, coarse = (
        change_parameters(
            dataclasses.replace(build_bone(), lattice_table=build_bone(sclerosis=of).lattice_table), **EVEN
        ).integrate(starts, ends)
        for of in (1.0, 1.5)
    )
    assert np.corrcoef(fine, coarse)[0, 1] > 0.9
    # Coarser struts make neighbouring values more similar.
    steps = [np.abs(np.diff(one)).mean() / one.std() for one in (fine, coarse)]
    assert steps[1] < 0.98 * steps[0]


def test_bone_volume_falls_with_age_and_is_lower_in_women():
    x = np.linspace(-20, 20, 60)
    young, old = (compute_bvtv(build_bone(age_years=age), x, -15.0) for age in (20.0, 90.0))
    assert_allclose(old / young, 1 - 0.265, atol=0.02)  # Khosla et al. 2006
    assert_allclose(
        compute_bvtv(build_bone(sex="female"), x, -15.0) / compute_bvtv(build_bone(), x, -15.0), 0.89, atol=1e-9
    )
    gains = [
        build_bone(sex="female", age_years=age).density_parameters.gain / build_bone().density_parameters.gain
        for age in (20.0, 90.0)
    ]
    assert_allclose(gains, (1 - 35 * 0.0015, 1 + 35 * 0.0015))


def test_relative_bone_density_scales_bone_volume_everywhere():
    x = np.linspace(-20, 20, 60)
    for z in (-4.0, -15.0, -40.0):
        assert_allclose(compute_bvtv(build_bone(density=1.3), x, z) / compute_bvtv(build_bone(), x, z), 1.3, rtol=1e-9)


def test_the_strut_fraction_below_the_plateau_changes_only_texture():
    """Check that the fraction of bone in struts, as opposed to fine mesh, does not affect the bone volume."""
    points = make_segments_along_y(np.linspace(15, 28, 400), -4.0)
    mesh, struts = (
        change_parameters(build_bone(), plate_struts=fraction).integrate(*points) for fraction in (0.0, 1.0)
    )
    assert struts.mean() == pytest.approx(mesh.mean(), rel=0.02)
    assert struts.std() > 1.3 * mesh.std()


def test_struts_sway_coherently_within_the_tabulated_amplitude():
    aside_mm = load_trabecular_bone().sway.amplitude_mm
    straight, swaying = (change_parameters(build_bone(), **EVEN | dict(sway_mm=of)) for of in (0.0, aside_mm))
    tried = np.linspace(-2.0, 2.0, 81)

    def shift_mm(x_mm, z_mm):
        """Estimate the local shift of swaying struts relative to straight ones."""
        # Shorter profiles could match by chance.
        x = x_mm + np.linspace(-5.0, 5.0, 101)
        profile = swaying.integrate(*make_segments_along_y(x, z_mm))
        shifted = straight.integrate(*make_segments_along_y(x[:, None] + tried, z_mm)).reshape(len(x), len(tried))
        return tried[np.argmax([np.corrcoef(profile, other)[0, 1] for other in shifted.T])]

    shifts = {(x, z): shift_mm(x, z) for x in (-10.0, -9.0, 12.0) for z in (-10.0, -16.0, -22.0, -28.0)}
    assert max(map(abs, shifts.values())) < 1.7 * aside_mm
    assert np.ptp([shifts[-10.0, z] for z in (-10.0, -16.0, -22.0, -28.0)]) > 0.3 * aside_mm
    assert all(abs(shifts[-10.0, z] - shifts[-9.0, z]) < 0.7 * aside_mm for z in (-10.0, -16.0, -22.0, -28.0))


def test_the_patchiness_of_trabecular_bone_varies_between_knees():
    table = load_trabecular_bone().lattice

    def measure_patchiness(seed):
        block = struts.make_strut_lattice(seed, table)[0][:-1, :-1].astype(np.float32)
        # The block edges are about 5, 3 and 16 mm long.
        coarse = block.reshape(16, 32, 16, 16, 4, 32).mean(axis=(1, 3, 5))
        return coarse.std() / block.std()

    found = [measure_patchiness(seed) for seed in range(5)]
    assert max(found) > 1.1 * min(found)
    none = msgspec.structs.replace(table, patches=(1e-6, 0.0))
    block = struts.make_strut_lattice(0, none)[0][:-1, :-1].astype(np.float32)
    assert block.reshape(16, 32, 16, 16, 4, 32).mean(axis=(1, 3, 5)).std() / block.std() < min(found)


def test_bone_size_scales_the_regions_but_not_the_struts():
    small, usual = (change_parameters(build_bone(scale=scale), **NO_STRUTS) for scale in (0.8, 1.0))
    starts, ends = sample_segments(200)
    assert_allclose(small.integrate(starts * 0.8, ends * 0.8), 0.8 * usual.integrate(starts, ends), rtol=2e-3)
    small, usual = (change_parameters(build_bone(scale=scale), **EVEN) for scale in (0.8, 1.0))
    assert_allclose(small.integrate(starts, ends), usual.integrate(starts, ends), rtol=1e-9)


LEVEL = dict(
    scar_lateral=0.0, scar_medial=1.0, scar_slope=0.0, scar_bow_per_mm=0.0, scar_dome_per_mm=0.0, scar_ripple_mm=0.0
)


def test_the_integral_of_a_thin_physeal_scar_is_complete():
    for half_mm in (0.5, 0.005):
        scarred = change_parameters(build_bone(), scar_per_mm=1 / half_mm, **LEVEL)
        at = np.array([[scarred.density_parameters.scar_off_mm, 0.0, scarred.density_parameters.scar_z]])
        up, across = np.array([0.0, 0.0, 20.0]), np.array([0.0, 15.0, 0.0])
        plain = change_parameters(scarred, scar_bvtv=0.0)
        added = [
            scarred.integrate(at - direction, at + direction) - plain.integrate(at - direction, at + direction)
            for direction in (up, across)
        ]
        strength = scarred.density_parameters.scar_bvtv * scarred.density_parameters.per_bvtv
        # The integral of the profile (1 + q^2)^-1.5 is twice its half thickness.
        assert_allclose(added[0], 2 * half_mm * strength, rtol=0.01)
        assert_allclose(added[1], 30.0 * strength, rtol=1e-6)
    assert all(-20 <= build_bone(seed=seed).density_parameters.scar_z <= -15 for seed in range(20))


def test_the_scar_is_densest_laterally_in_femur_and_medially_in_tibia(means_of_24_seeds):
    for name in SCAR_ORDER:
        most, less, least = means_of_24_seeds[name]
        assert most > 1.2 * less > 1.44 * least


def _integrate_scar(density: Trabeculae, sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Integrate the scar density (sides,) along vertical segments where the scar is horizontal."""
    flat = change_parameters(
        density,
        **{
            **LEVEL,
            "scar_lateral": density.density_parameters.scar_lateral,
            "scar_medial": density.density_parameters.scar_medial,
        },
    )
    x_mm = sides * density.density_parameters.scar_off_mm
    at, direction = (
        np.stack([x_mm, 0 * x_mm, 0 * x_mm + density.density_parameters.scar_z], axis=1),
        np.array([0.0, 0.0, 20.0]),
    )
    return flat.integrate(at - direction, at + direction) - change_parameters(flat, scar_bvtv=0.0).integrate(
        at - direction, at + direction
    )


def test_a_domed_physeal_scar_projects_to_a_line_at_every_beam_angle():
    """Check that a domed scar, unlike a flat one, is tangential to beams at all angles up to 8 degrees."""
    heights = np.linspace(-8.0, 8.0, 161)
    for degrees in (0.0, 5.0, 8.0):
        rise = np.tan(np.deg2rad(degrees))
        sharp = {}
        for name, form in (("level", LEVEL), ("domed", {**LEVEL, "scar_dome_per_mm": -0.004})):
            scarred = change_parameters(build_bone(), scar_y=0.0, scar_bvtv=0.1, **form)
            middle = np.array(
                [scarred.density_parameters.scar_off_mm, 0.0, scarred.density_parameters.scar_z]
            ) + heights[:, None] * [0, 0, 1]
            direction = np.array([0.0, 22.0, 22.0 * rise])
            plain = change_parameters(scarred, scar_bvtv=0.0)
            added = [one.integrate(middle - direction, middle + direction) for one in (scarred, plain)]
            sharp[name] = float(np.abs(np.diff(added[0] - added[1])).max())
        assert sharp["domed"] > 0.5
        assert degrees == 0.0 or sharp["domed"] > 2.0 * sharp["level"]


def test_path_lengths_between_surfaces_are_integrals_of_their_density():
    density = build_bone()
    box, canal = (trimesh.creation.box((size, size, size)) for size in (30.0, 12.0))
    scene = pssf.Scene(
        [
            pssf.Surface(box, inside="trabecular_bone", outside="air", name="box", inside_density=density),
            pssf.Surface(canal, inside="marrow", outside="trabecular_bone", name="canal", outside_density=density),
        ]
    )
    view = View(source_mm=(0, -950, 0), centre_mm=(0, 200, 0), rows=3, cols=3, pixel_mm=2.0)
    paths = pssf.trace(scene, view, engine="scanline", precision="float64").path_mm
    # Direction from the source to the top left pixel.
    direction = np.array([-2.0, 1150.0, 2.0])
    depths = np.array([935.0, 944.0, 956.0, 965.0]) / 1150.0
    points = np.array([0.0, -950.0, 0.0]) + depths[:, None] * direction
    expected = density.integrate(points[[0, 2]], points[[1, 3]]).sum()
    assert_allclose(paths["trabecular_bone"][0, 0], expected, rtol=1e-9)
    assert_allclose(paths["marrow"][0, 0], np.linalg.norm(points[2] - points[1]), rtol=1e-9)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mirror": (1.0, 2.0, 1.0)}, r"mirror must be .*, got \(1.0, 2.0, 1.0\)"),
        ({"sex": "none"}, "sex must be .*, got 'none'"),
        ({"seed": -1}, "seed must be .*, got -1"),
        ({"scale": 3.0}, "scale must be .*, got 3.0"),
        ({"sclerosis": float("nan")}, "sclerosis must be .*, got nan"),
        ({"age_years": 5.0}, "age_years must be .*, got 5.0"),
        ({"density": 0.0}, "density must be .*, got 0.0"),
        ({"frame": 2 * np.eye(3, 4)}, "frame must be a rotation"),
        ({"frame": np.diag([1.0, 1.0, -1.0, 1.0])[:3]}, "frame must be a rotation"),
        ({"frame": np.eye(4)}, "frame must be a rotation"),
    ],
)
def test_invalid_trabecular_parameters_raise_an_error(changed, message):
    with pytest.raises(InputError, match=message):
        build_bone(**changed)
    with pytest.raises(InputError, match=r"bone must be one of .*, got 'humerus'"):
        build_bone("humerus")


def test_only_the_medial_plateau_has_little_trabecular_bone_at_its_rims():
    full = change_parameters(build_bone(), **NO_STRUTS)
    filled = change_parameters(build_bone(), **NO_STRUTS, rim=0.0)
    rims = compute_bvtv(full, 23.0, -1.0) / compute_bvtv(filled, 23.0, -1.0)
    assert rims < 0.4
    assert compute_bvtv(full, 23.0, -9.0) > 0.95 * compute_bvtv(filled, 23.0, -9.0)
    assert compute_bvtv(full, -23.0, -1.0) > 0.9 * compute_bvtv(filled, -23.0, -1.0)
    # The intercondylar eminence is not affected.
    assert compute_bvtv(full, 3.0, 4.0) > 0.85 * compute_bvtv(filled, 3.0, 4.0)
    for other in ("femur", "fibula", "patella"):
        assert build_bone(other).density_parameters.rim == 0.0
