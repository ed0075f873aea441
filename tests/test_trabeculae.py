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


def bone(name: str = "tibia", **changed) -> Trabeculae:
    return build_trabeculae(name, load_trabecular_bone(), **{**HEALTHY, **changed})


def region(density: Trabeculae, **changed) -> Trabeculae:
    return dataclasses.replace(density, density_parameters=density.density_parameters._replace(**changed))


def segments(count: int, seed: int = 0, spread_mm: float = 40.0) -> np.ndarray:
    """(2, count, 3)  starts and ends in any direction"""
    return np.random.default_rng(seed).normal(size=(2, count, 3)) * spread_mm


def through(x_mm, z_mm, half_mm: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """Segments along y through places (x, z)."""
    x, z = np.broadcast_arrays(np.asarray(x_mm, float).ravel(), np.asarray(z_mm, float).ravel())
    return np.column_stack((x, x * 0 - half_mm, z)), np.column_stack((x, x * 0 + half_mm, z))


def usual_bvtv(*places) -> np.ndarray:
    """(places,)  mean of people's, who have their dense and bare patches each in other places; x, z and half the way"""
    return np.mean([[bvtv(bone(seed=seed), *place) for place in places] for seed in range(24)], axis=0)


def bvtv(density: Trabeculae, x_mm, z_mm, half_mm: float = 20.0) -> float:
    """Mean BV/TV of a man of 55 along y, between places (x, z)."""
    starts, ends = through(x_mm, z_mm, half_mm)
    tissue = data_files.load_data_table("trabeculae")["tissue"]
    mean = density.integrate(starts, ends).mean() / (2 * half_mm)
    return (mean - tissue["marrow"]) / (1 - tissue["marrow"]) * tissue["bvtv"]


def turn(degrees: float) -> np.ndarray:
    """A rotation about an oblique axis."""
    return trimesh.transformations.rotation_matrix(np.deg2rad(degrees), (1.0, 2.0, -0.5))[:3, :3]


@pytest.fixture(scope="module")
def patch() -> np.ndarray:
    """(128, 128)  integrals of 40 mm along y of even trabecular bone, every 0.15 mm; rows from proximal"""
    x, z = np.meshgrid(np.arange(128) * 0.15 + 13, -np.arange(128) * 0.15 - 6)
    return region(bone(), **EVEN).integrate(*through(x, z)).reshape(x.shape)


def test_without_struts_and_regions_the_integral_is_the_length():
    starts, ends = segments(500)
    length = np.linalg.norm(ends - starts, axis=1)
    even = region(bone(), **FLAT, **NO_STRUTS)
    assert_allclose(even.integrate(starts, ends), length, rtol=1e-12)
    assert_allclose(
        region(even, marrow=0.0).integrate(starts, ends), length * (1 - even.density_parameters.marrow), rtol=1e-12
    )


def test_a_segment_without_length_and_no_segments_give_nothing():
    starts, _ = segments(3)
    assert bone().integrate(starts, starts).tolist() == [0.0, 0.0, 0.0]
    assert bone().integrate(starts[:0], starts[:0]).shape == (0,)
    assert isinstance(bone(), Density)


@pytest.mark.parametrize("name", BONES)
@pytest.mark.parametrize("along_y", [0.0, 1.0])
def test_integrals_of_the_parts_of_a_segment_add_up_to_that_of_the_whole(name, along_y):
    starts, ends = segments(300)
    # Within a few degrees of y, and in any direction: samples are placed in two ways.
    ends = ends + along_y * (starts + np.array([0.0, 60.0, 0.0]) - ends) + along_y * segments(300, 2, 1.0)[0]
    share = np.random.default_rng(1).random((300, 1))
    middles = starts + share * (ends - starts)
    density = bone(name)
    parts = density.integrate(starts, middles) + density.integrate(middles, ends)
    assert_allclose(parts, density.integrate(starts, ends), atol=1e-9)


def test_a_segment_run_along_the_other_way_has_the_same_integral():
    starts, ends = segments(300)
    assert_allclose(bone().integrate(starts, ends), bone().integrate(ends, starts), rtol=1e-9)


@pytest.mark.parametrize("oblique", [0.0, 20.0])
def test_the_integral_of_a_segment_does_not_depend_on_those_beside_it(oblique):
    # Segments are worked on side by side: of any length, some of none, along y and across it.
    starts, ends = segments(37)
    ends = starts + np.array([0.0, 1.0, 0.0]) * (ends - starts) + oblique * segments(37, 2, 1.0)[0]
    ends[5] = starts[5]
    together = bone().integrate(starts, ends)
    for order in (np.arange(37)[::-1], np.random.default_rng(4).permutation(37)):
        assert np.array_equal(bone().integrate(starts[order], ends[order]), together[order])
    alone = [bone().integrate(starts[[k]], ends[[k]])[0] for k in range(37)]
    assert np.array_equal(alone, together)


def test_the_same_seed_is_the_same_bone_and_another_seed_is_another():
    starts, ends = through(np.linspace(-30, 30, 400), -12.0)
    first, again, other = (bone(seed=seed) for seed in (5, 5, 6))
    assert first == again
    assert first != other
    one, two, three = (density.integrate(starts, ends) for density in (first, other, again))
    assert np.array_equal(one, three)
    assert abs(np.corrcoef(one - np.convolve(one, np.ones(40) / 40, "same"), two)[0, 1]) < 0.3


def test_the_bones_of_a_knee_have_struts_of_their_own():
    starts, ends = through(np.linspace(-30, 30, 400), -12.0)
    one, two = (region(bone(name), **EVEN).integrate(starts, ends) for name in ("tibia", "femur"))
    assert one.std() > 0.3
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.3


def test_moving_bone_and_rays_together_changes_nothing():
    starts, ends = segments(300)
    matrix, shift = turn(37.0), np.array([3.0, -11.0, 25.0])
    moved = bone(frame=np.column_stack((matrix, shift)))
    found = moved.integrate(starts @ matrix.T + shift, ends @ matrix.T + shift)
    assert_allclose(found, bone().integrate(starts, ends), rtol=1e-9)
    assert np.abs(moved.integrate(starts, ends) / found - 1).max() > 0.01


def test_a_left_knee_is_the_mirror_image_of_a_right_one():
    starts, ends = segments(300)
    frame, flip = np.column_stack((turn(8.0), (2.0, 1.0, -4.0))), np.array([-1.0, 1.0, 1.0])
    right, left = (bone(frame=frame, mirror=(x, 1.0, 1.0)) for x in (1.0, -1.0))
    assert_allclose(left.integrate(starts * flip, ends * flip), right.integrate(starts, ends), rtol=1e-9)
    assert np.abs(left.integrate(starts, ends) / right.integrate(starts, ends) - 1).max() > 0.01


@pytest.mark.parametrize("name", BONES)
def test_density_is_never_below_that_of_marrow_and_comes_near_it_between_struts(name):
    rng = np.random.default_rng(0)
    starts = rng.uniform(-60, 60, (20_000, 3))
    ends = starts + rng.normal(size=starts.shape) * 0.02
    density = bone(name, sclerosis=2.5, age_years=20.0)
    thin = bone(name, sclerosis=0.5)
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


def test_a_lattice_with_edges_of_any_softness_is_made_without_an_overflow():
    table = msgspec.structs.replace(load_trabecular_bone().lattice, voxels=(32, 32, 16), waves_y=8, softness=0.01)
    with np.errstate(over="raise"):
        block, _ = struts.make_strut_lattice(3, table)
    assert block.min() == 0
    assert block.max() == 255


def test_the_lattice_is_bone_in_about_its_share_and_repeats():
    block, unit = struts.make_strut_lattice(3, load_trabecular_bone().lattice)
    assert block.shape == (513, 257, 128)
    assert np.array_equal(block[-1], block[0])
    assert np.array_equal(block[:, -1], block[:, 0])
    block = block[:-1, :-1]
    assert_allclose(block.mean() * unit, 1.0, rtol=1e-12)
    assert 0.08 < (block > 127).mean() < 0.18  # BV/TV of metaphyses in the reference list: 0.08 to 0.20
    even = region(bone(), **EVEN)
    starts, ends = through(np.linspace(-20, 20, 200), -12.0)
    for period_mm in ((81.92, 0.0, 0.0), (0.0, 64.0, 0.0), (0.0, 0.0, 51.2)):
        assert_allclose(even.integrate(starts + period_mm, ends + period_mm), even.integrate(starts, ends), rtol=1e-6)
    assert np.abs(even.integrate(starts + 20.0, ends + 20.0) / even.integrate(starts, ends) - 1).max() > 0.01


def test_the_lattice_is_made_once_when_it_is_needed_and_for_one_seed_at_a_time(monkeypatch):
    made = []

    def make(seed, table):
        made.append(seed)
        time.sleep(0.05)  # long enough for a second thread to ask as well
        block = np.zeros((513, 257, 128), np.uint8)
        block.setflags(write=False)
        return block, 1.0

    monkeypatch.setattr(struts, "_synthesise_lattice", make)
    monkeypatch.setattr(struts, "_CACHE", {})
    density, ends = bone(seed=11), segments(10)
    density.integrate(*segments(0))
    assert made == []
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: density.integrate(*ends), range(8)))
    bone("femur", seed=11).integrate(*ends)
    assert made == [11]
    bone(seed=12).integrate(*ends)
    assert made == [11, 12]
    assert [seed for seed, _ in struts._CACHE] == [12]


def test_projected_struts_are_upright_fine_and_about_gaussian(patch):
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
    # Two slopes: flat to the struts' own spacing, steep above; the detector's blur adds 2 to the second.
    assert -1.8 < np.log(middle / low) / np.log(1.0 / 0.4) < 0.2
    assert -3.5 < np.log(high / middle) / np.log(2.4) < -1.2


def test_bone_is_denser_at_the_plate_and_medially_and_fades_down_the_shaft():
    x = np.linspace(-4, 4, 30)
    # Drawn knees have the floor of the medial plateau some 3 mm below its edges, which are at 0.
    sides = [(x + at, z, 12.0) for at in (23.0, -23.0) for z in (-7.0, -11.0, -18.0)]
    deep = [(x + 23, z, 22.5) for z in np.arange(-22, -6, 3)]
    medial, lateral, metaphysis = np.split(usual_bvtv(*sides, *deep), (3, 6))
    assert medial[0] > 1.15 * medial[1] > 1.15 * medial[2]
    # Medial over lateral over the first 6 mm (J Orthop Res 2003 21:6); 8 to 28 mm deep people's tibiae are brighter
    # laterally on films, by little (trabeculae.toml), and the scar, whose side is drawn, is there.
    assert medial[0] > 1.1 * lateral[0]
    assert medial[1] > lateral[1]
    assert 0.9 < medial[2] / lateral[2] < 1.1
    assert 0.18 < medial[0] < 0.37
    assert 0.08 < medial[2] < 0.22
    assert bvtv(bone(), x, -120.0) < 0.05
    assert 0.7 < 1.083 * 4.5 * metaphysis.mean() < 1.15
    wavy, calm = (bone().integrate(*through(np.linspace(-8, 8, 200), z)).std() for z in (-30.0, -130.0))
    assert calm < 0.2 * wavy


def test_sclerosis_makes_bone_under_the_plate_denser_medially_most_and_leaves_the_shaft():
    # Its struts are coarser as well, so that single ones are not the same.
    x, healthy, hard = np.linspace(-4, 4, 30), *(region(bone(sclerosis=of), **NO_STRUTS) for of in (1.0, 1.78))
    rise = {(at, z): bvtv(hard, x + at, z) / bvtv(healthy, x + at, z) for at in (23.0, -23.0) for z in (-5.5, -80.0)}
    assert 1.25 < rise[23.0, -5.5] < 1.47  # Rapagna 2021: 1.47 right under the plate
    # On films of KL 3 and 4 the tibia is brighter all across (trabeculae.toml).
    assert 1.1 < rise[-23.0, -5.5] < rise[23.0, -5.5]
    assert all(1.0 <= rise[at, -80.0] < 1.02 for at in (23.0, -23.0))
    # It goes deeper than the plate's own rise does.
    below = {
        name: bvtv(bone_of, x + 23.0, -12.0) / bvtv(bone_of, x + 23.0, -5.5)
        for name, bone_of in (("healthy", healthy), ("hard", hard))
    }
    assert below["hard"] > below["healthy"]
    # The contrast of struts falls all over the knee, in the fibula that alone.
    fibula, filled = (bone("fibula", sclerosis=of).density_parameters for of in (1.0, 1.78))
    assert filled.gain < 0.85 * fibula.gain
    assert filled._replace(gain=fibula.gain, gain_shaft=fibula.gain_shaft) == fibula


def test_struts_are_coarser_in_hard_bone_and_in_old_women_and_stay_where_they_are():
    def finest(**changed) -> float:
        return bone(**changed).lattice_table.high_per_mm

    assert finest(sclerosis=1.5) < finest() / 1.1
    assert finest(sex="female", age_years=90.0) < finest(sex="female", age_years=20.0)
    assert bone("femur", sclerosis=1.5).lattice_table == bone(sclerosis=1.5).lattice_table
    assert len({finest(seed=seed) for seed in range(20)}) > 15
    starts, ends = through(np.linspace(-20, 20, 400), -12.0)
    fine, coarse = (
        region(dataclasses.replace(bone(), lattice_table=bone(sclerosis=of).lattice_table), **EVEN).integrate(
            starts, ends
        )
        for of in (1.0, 1.5)
    )
    assert np.corrcoef(fine, coarse)[0, 1] > 0.9
    # Neighbours are the more alike.
    steps = [np.abs(np.diff(one)).mean() / one.std() for one in (fine, coarse)]
    assert steps[1] < 0.98 * steps[0]


def test_age_and_sex_take_bone_away():
    x = np.linspace(-20, 20, 60)
    young, old = (bvtv(bone(age_years=age), x, -15.0) for age in (20.0, 90.0))
    assert_allclose(old / young, 1 - 0.265, atol=0.02)  # Khosla et al. 2006
    assert_allclose(bvtv(bone(sex="female"), x, -15.0) / bvtv(bone(), x, -15.0), 0.89, atol=1e-9)
    swing = [
        bone(sex="female", age_years=age).density_parameters.gain / bone().density_parameters.gain
        for age in (20.0, 90.0)
    ]
    assert_allclose(swing, (1 - 35 * 0.0015, 1 + 35 * 0.0015))


def test_a_person_of_denser_bone_has_so_much_more_of_it_everywhere():
    x = np.linspace(-20, 20, 60)
    for z in (-4.0, -15.0, -40.0):
        assert_allclose(bvtv(bone(density=1.3), x, z) / bvtv(bone(), x, z), 1.3, rtol=1e-9)


def test_what_bone_there_is_more_at_the_plate_is_struts_by_its_share():
    """Between them a plate's mesh is left, and the more of it the smaller the share; there is as much bone."""
    places = through(np.linspace(15, 28, 400), -4.0)
    mesh, struts = (region(bone(), plate_struts=share).integrate(*places) for share in (0.0, 1.0))
    assert struts.mean() == pytest.approx(mesh.mean(), rel=0.02)
    assert struts.std() > 1.3 * mesh.std()


def test_struts_wave_from_side_to_side_by_no_more_than_is_said_and_neighbours_alike():
    aside_mm = load_trabecular_bone().sway.amplitude_mm
    straight, swaying = (region(bone(), **EVEN | dict(sway_mm=of)) for of in (0.0, aside_mm))
    tried = np.linspace(-2.0, 2.0, 81)

    def shift_mm(x_mm, z_mm):
        """By how much what swaying struts show about a place is shifted from what straight ones do."""
        x = x_mm + np.linspace(-5.0, 5.0, 101)  # over fewer struts another shift fits as well by chance
        shown = swaying.integrate(*through(x, z_mm))
        there = straight.integrate(*through(x[:, None] + tried, z_mm)).reshape(len(x), len(tried))
        return tried[np.argmax([np.corrcoef(shown, other)[0, 1] for other in there.T])]

    shifts = {(x, z): shift_mm(x, z) for x in (-10.0, -9.0, 12.0) for z in (-10.0, -16.0, -22.0, -28.0)}
    assert max(map(abs, shifts.values())) < 1.7 * aside_mm
    assert np.ptp([shifts[-10.0, z] for z in (-10.0, -16.0, -22.0, -28.0)]) > 0.3 * aside_mm
    assert all(abs(shifts[-10.0, z] - shifts[-9.0, z]) < 0.7 * aside_mm for z in (-10.0, -16.0, -22.0, -28.0))


def test_knees_differ_in_how_patchy_their_bone_is():
    table = load_trabecular_bone().lattice

    def patchiness(seed):
        block = struts.make_strut_lattice(seed, table)[0][:-1, :-1].astype(np.float32)
        coarse = block.reshape(16, 32, 16, 16, 4, 32).mean(axis=(1, 3, 5))  # some 5, 3 and 16 mm
        return coarse.std() / block.std()

    found = [patchiness(seed) for seed in range(5)]
    assert max(found) > 1.1 * min(found)
    none = msgspec.structs.replace(table, patches=(1e-6, 0.0))
    block = struts.make_strut_lattice(0, none)[0][:-1, :-1].astype(np.float32)
    assert block.reshape(16, 32, 16, 16, 4, 32).mean(axis=(1, 3, 5)).std() / block.std() < min(found)


def test_a_bone_of_another_size_has_the_same_regions_further_apart_and_struts_of_the_same_size():
    small, usual = (region(bone(scale=scale), **NO_STRUTS) for scale in (0.8, 1.0))
    starts, ends = segments(200)
    assert_allclose(small.integrate(starts * 0.8, ends * 0.8), 0.8 * usual.integrate(starts, ends), rtol=2e-3)
    small, usual = (region(bone(scale=scale), **EVEN) for scale in (0.8, 1.0))
    assert_allclose(small.integrate(starts, ends), usual.integrate(starts, ends), rtol=1e-9)


LEVEL = dict(
    scar_lateral=0.0, scar_medial=1.0, scar_slope=0.0, scar_bow_per_mm=0.0, scar_dome_per_mm=0.0, scar_ripple_mm=0.0
)


def test_the_scar_is_counted_in_full_however_thin_it_is():
    for half_mm in (0.5, 0.005):
        scarred = region(bone(), scar_per_mm=1 / half_mm, **LEVEL)
        at = np.array([[scarred.density_parameters.scar_off_mm, 0.0, scarred.density_parameters.scar_z]])
        up, across = np.array([0.0, 0.0, 20.0]), np.array([0.0, 15.0, 0.0])
        plain = region(scarred, scar_bvtv=0.0)
        added = [scarred.integrate(at - way, at + way) - plain.integrate(at - way, at + way) for way in (up, across)]
        strength = scarred.density_parameters.scar_bvtv * scarred.density_parameters.per_bvtv
        # The profile (1 + q^2)^-1.5 holds twice its half thickness.
        assert_allclose(added[0], 2 * half_mm * strength, rtol=0.01)
        assert_allclose(added[1], 30.0 * strength, rtol=1e-6)
    assert all(-20 <= bone(seed=seed).density_parameters.scar_z <= -15 for seed in range(20))


def test_the_scar_of_a_femur_is_strongest_laterally_and_that_of_a_tibia_medially_and_of_neither_in_the_middle():
    for name, order in (("femur", (-1, 1, 0)), ("tibia", (1, -1, 0))):
        scarred = [bone(name, seed=seed) for seed in range(24)]
        most, less, least = np.mean([_scar_over(one, np.array(order)) for one in scarred], axis=0)
        assert most > 1.2 * less > 1.44 * least


def _scar_over(density: Trabeculae, sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """(sides,) What the scar adds to the integral of density down the places where it is level."""
    flat = region(
        density,
        **{
            **LEVEL,
            "scar_lateral": density.density_parameters.scar_lateral,
            "scar_medial": density.density_parameters.scar_medial,
        },
    )
    x_mm = sides * density.density_parameters.scar_off_mm
    at, way = (
        np.stack([x_mm, 0 * x_mm, 0 * x_mm + density.density_parameters.scar_z], axis=1),
        np.array([0.0, 0.0, 20.0]),
    )
    return flat.integrate(at - way, at + way) - region(flat, scar_bvtv=0.0).integrate(at - way, at + way)


def test_the_scar_is_seen_as_a_line_from_whatever_height_it_is_looked_at():
    """A level sheet is seen as one only edge on; a domed one has a place that is edge on to any beam of up to 8 deg."""
    heights = np.linspace(-8.0, 8.0, 161)
    for degrees in (0.0, 5.0, 8.0):
        rise = np.tan(np.deg2rad(degrees))
        sharp = {}
        for name, form in (("level", LEVEL), ("domed", {**LEVEL, "scar_dome_per_mm": -0.004})):
            scarred = region(bone(), scar_y=0.0, scar_bvtv=0.1, **form)
            middle = np.array(
                [scarred.density_parameters.scar_off_mm, 0.0, scarred.density_parameters.scar_z]
            ) + heights[:, None] * [0, 0, 1]
            way = np.array([0.0, 22.0, 22.0 * rise])
            plain = region(scarred, scar_bvtv=0.0)
            added = [one.integrate(middle - way, middle + way) for one in (scarred, plain)]
            sharp[name] = float(np.abs(np.diff(added[0] - added[1])).max())
        assert sharp["domed"] > 0.5
        assert degrees == 0.0 or sharp["domed"] > 2.0 * sharp["level"]


def test_between_surfaces_that_share_a_density_the_path_is_its_integral_there():
    density = bone()
    box, canal = (trimesh.creation.box((size, size, size)) for size in (30.0, 12.0))
    scene = pssf.Scene(
        [
            pssf.Surface(box, inside="trabecular_bone", outside="air", name="box", inside_density=density),
            pssf.Surface(canal, inside="marrow", outside="trabecular_bone", name="canal", outside_density=density),
        ]
    )
    view = View(source_mm=(0, -950, 0), centre_mm=(0, 200, 0), rows=3, cols=3, pixel_mm=2.0)
    paths = pssf.trace(scene, view, engine="scanline", precision="float64").path_mm
    way = np.array([-2.0, 1150.0, 2.0])  # from the source to the pixel on the top left
    depths = np.array([935.0, 944.0, 956.0, 965.0]) / 1150.0
    places = np.array([0.0, -950.0, 0.0]) + depths[:, None] * way
    expected = density.integrate(places[[0, 2]], places[[1, 3]]).sum()
    assert_allclose(paths["trabecular_bone"][0, 0], expected, rtol=1e-9)
    assert_allclose(paths["marrow"][0, 0], np.linalg.norm(places[2] - places[1]), rtol=1e-9)


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
def test_what_makes_no_bone_is_refused_by_name(changed, message):
    with pytest.raises(InputError, match=message):
        bone(**changed)
    with pytest.raises(InputError, match=r"bone must be one of .*, got 'humerus'"):
        bone("humerus")


def test_rims_of_the_medial_plateau_above_its_floor_are_bare_and_no_others():
    full = region(bone(), **NO_STRUTS)
    filled = region(bone(), **NO_STRUTS, rim=0.0)
    rims = bvtv(full, 23.0, -1.0) / bvtv(filled, 23.0, -1.0)
    assert rims < 0.4
    assert bvtv(full, 23.0, -9.0) > 0.95 * bvtv(filled, 23.0, -9.0)
    assert bvtv(full, -23.0, -1.0) > 0.9 * bvtv(filled, -23.0, -1.0)
    # The eminence is none of it.
    assert bvtv(full, 3.0, 4.0) > 0.85 * bvtv(filled, 3.0, 4.0)
    for other in ("femur", "fibula", "patella"):
        assert bone(other).density_parameters.rim == 0.0
