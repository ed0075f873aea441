"""Check the simulation of radiographs: reproducibility, stored images, errors, texture, scatter and noise."""

import dataclasses
import hashlib
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from conftest import build_once, forget_built_knees
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import binary_dilation

import pssf
from pssf.anatomy.trabeculae.trabecular_density import Trabeculae
from pssf.stages import LatentImage, StageContext, run_stages
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.spectrum import RELATIVE_TOLERANCE

DIGEST = """
import dataclasses, hashlib, pssf
protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=128, cols=128, pixel_mm=2.4)
radiograph = pssf.simulate(pssf.Knee(jsw_medial_mm=3.1), protocol, rng=7, workers={workers})
print(hashlib.sha256(radiograph.pixels.tobytes()).hexdigest())
"""


def compute_digest_in_new_process(workers):
    script = [sys.executable, "-c", DIGEST.format(workers=workers)]
    return subprocess.run(script, capture_output=True, text=True, check=True).stdout.strip()


def test_a_seed_gives_identical_pixels_for_any_number_of_workers(capsys):
    exec(DIGEST.format(workers=1))
    assert capsys.readouterr().out.strip() == compute_digest_in_new_process(2)


def test_another_seed_changes_only_the_noise(built, small):
    one, two = (pssf.simulate(built, small, rng=s, keep=("noise_free",)) for s in (1, 2))
    assert (one.kept["noise_free"] == two.kept["noise_free"]).all()
    assert (one.pixels != two.pixels).mean() > 0.5


def test_both_engines_give_the_same_noise_free_image(built, small):
    quiet = dataclasses.replace(small, noise="none")
    one, two = (pssf.simulate(built, quiet, engine=e).pixels.astype(int) for e in ("embree", "scanline"))
    assert abs(one - two).max() <= 1


def test_only_requested_intermediate_images_are_stored(built, small):
    assert pssf.simulate(built, small).kept == {}
    wanted = ("path_mm", "primary", "scatter", "noise_free")
    kept = pssf.simulate(built, small, keep=wanted).kept
    assert tuple(sorted(kept)) == tuple(sorted(wanted))
    assert kept["path_mm"]["cortical_bone"].shape == (256, 256)
    assert kept["path_mm"]["cortical_bone"].dtype == np.float32


@pytest.mark.parametrize("keep", [None, 3, "masks"])
def test_keep_that_is_not_a_list_raises_an_error(built, small, keep):
    with pytest.raises(pssf.InputError, match=r"keep must be a list with names from path_mm.*, got "):
        pssf.simulate(built, small, keep=keep)


def test_monochromatic_energy_may_be_an_integer(scene, small):
    mono = [dataclasses.replace(small, mono_kev=energy, scatter="none") for energy in (60, 60.0)]
    one, two = (pssf.simulate(scene, protocol, engine="scanline") for protocol in mono)
    assert (one.pixels == two.pixels).all()


def test_an_unknown_image_name_in_keep_raises_an_error(built, small):
    with pytest.raises(pssf.InputError, match=r"keep must be one of .*, got 'path'"):
        pssf.simulate(built, small, keep=("path",))


def test_no_ray_remains_unrepaired_under_any_protocol(built):
    for name in ("reference", "low_dose", "geometry_shift"):
        protocol = dataclasses.replace(pssf.load_protocol(name), rows=256, cols=256, pixel_mm=1.2)
        assert pssf.simulate(built, protocol).audit["unrepaired"] == 0


def test_truth_contains_labels_and_the_position_of_the_medial_joint_line(built, small):
    truth = pssf.simulate(built, small).truth
    assert (truth.jsw_medial_mm, truth.jsw_lateral_mm) == pytest.approx((3.1, 5.0), abs=1e-3)
    assert truth.grade == 2
    row, col = truth.landmarks_px["joint_centre"]
    assert row == pytest.approx(127.5, abs=2)
    row, col = truth.medial_joint_line_px
    assert col > 140


def test_the_joint_space_has_no_bone_between_femur_and_tibia(built, knee, scene, small):
    bare = dataclasses.replace(small, noise="none", scatter="none", detector_blur="none", focal_spot_mm=0.0)
    kept = pssf.simulate(built, bare, keep=("path_mm",)).kept["path_mm"]
    bone = kept["cortical_bone"] + kept["trabecular_bone"]
    row, col = (round(v) for v in find_joint_line(built, small))
    assert bone[row, col] == 0
    assert bone[row - 12, col] > 20
    assert bone[row + 12, col] > 20


def find_joint_line(built, protocol):
    return pssf.simulate(built, protocol).truth.medial_joint_line_px


def test_user_meshes_give_a_radiograph_without_labels(small):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=60)
    core = trimesh.creation.box(extents=(20, 20, 20))
    scene = pssf.Scene([
        pssf.Surface(ball, inside="muscle", outside="air", name="ball"),
        pssf.Surface(core, inside="Ti@4.51", outside="muscle", name="core"),
    ])  # fmt: skip
    radiograph = pssf.simulate(scene, small, rng=3)
    assert radiograph.truth is None
    assert radiograph.knee is None
    assert radiograph.pixels[128, 128] < radiograph.pixels[128, 160] < radiograph.pixels[5, 5]


def test_an_unknown_material_raises_an_error_with_a_suggestion(small):
    ball = trimesh.creation.icosphere(radius=20)
    scene = pssf.Scene([pssf.Surface(ball, inside="mucsle", outside="air")])
    with pytest.raises(pssf.InputError, match=r"material must be one of .*, got 'mucsle'.*did you mean 'muscle'"):
        pssf.simulate(scene, small)


def test_halving_the_tube_current_halves_the_signal(built, small):
    quiet = dataclasses.replace(small, noise="none")
    half = dataclasses.replace(quiet, mas=1.0)
    full_px, half_px = (pssf.simulate(built, p).pixels.astype(float) - 100 for p in (quiet, half))
    assert_allclose(half_px, full_px / 2, atol=1.01)


def test_sampling_and_simulating_a_knee_twice_gives_identical_pixels(small):
    digests = set()
    for _ in range(2):
        knee = pssf.sample_knee(grade=1, rng=np.random.default_rng(4), grade_table="paper")
        forget_built_knees()
        digests.add(hashlib.sha256(pssf.simulate(knee, small, rng=9).pixels.tobytes()).hexdigest())
    assert len(digests) == 1


def test_a_surface_with_a_wrong_outside_material_raises_an_error(small):
    box = trimesh.creation.box(extents=(40, 40, 40))
    with pytest.raises(
        pssf.InputError, match=r"muscle: path length must be .*, got -\d+.* mm at pixel .*: outside is muscle, but"
    ):
        pssf.simulate(pssf.Scene([pssf.Surface(box, inside="cortical_bone", outside="muscle")]), small)


@pytest.mark.parametrize("ambient", ["muscel", "Ti@-1", "Zz@1"])
def test_an_unknown_ambient_material_raises_an_error(small, ambient):
    box = trimesh.creation.box(extents=(40, 40, 40))
    with pytest.raises(pssf.InputError, match=ambient.split("@")[0]):
        pssf.simulate(pssf.Scene([pssf.Surface(box, inside="muscle", outside="air")], ambient=ambient), small)


@pytest.mark.parametrize(("knee", "protocol"), [("knee", None), (None, 7), (None, pssf.Knee())])
def test_an_invalid_knee_or_protocol_raises_an_error(small, knee, protocol):
    with pytest.raises(pssf.InputError, match=r"must be a (Knee, a BuiltKnee, .* or a Scene|Protocol)"):
        pssf.simulate(knee or pssf.Knee(), protocol or small)


def test_parameters_may_be_numpy_numbers(small, tmp_path):
    protocol = dataclasses.replace(small, rows=np.int64(64), cols=64, pixel_mm=np.float32(4.8))
    knee = pssf.Knee(jsw_medial_mm=np.float64(3.0))
    back = pssf.load(pssf.save(pssf.simulate(knee, protocol, rng=np.int64(5)), tmp_path / "k.tif"))
    assert (back.knee, back.seed, back.protocol.rows) == (knee, 5, 64)


def test_no_texture_is_computed_if_the_protocol_disables_texture(built, small, monkeypatch):
    textured = pssf.simulate(built, small, engine="scanline", keep=("path_mm",))

    def integrate(*_):
        raise AssertionError

    monkeypatch.setattr(Trabeculae, "integrate", integrate)
    smooth = dataclasses.replace(small, texture="none")
    plain = pssf.simulate(built, smooth, engine="scanline", keep=("path_mm",))
    lengths = [image.kept["path_mm"]["trabecular_bone"] for image in (textured, plain)]
    # Trabecular bone varies around the density of its material; other materials do not change.
    assert 0.5 < lengths[0].sum() / lengths[1].sum() < 2
    assert np.abs(lengths[0] - lengths[1]).max() > 1
    assert_array_equal(*(image.kept["path_mm"]["cortical_bone"] for image in (textured, plain)))


def test_a_new_texture_seed_changes_only_pixels_of_bone(knee, small):
    still = dataclasses.replace(small, noise="none", scatter="none", focal_spot_mm=0.0, detector_blur="none")
    # The limb is thick enough for the patella, whose position depends on the roughness of the femur.
    roomy = dataclasses.replace(knee, limb_ap_mm=140.0)
    images = [
        pssf.simulate(dataclasses.replace(roomy, texture_seed=seed), still, engine="scanline", keep=("path_mm",))
        for seed in (1, 2)
    ]
    trabecular = images[0].kept["path_mm"]["trabecular_bone"] > 0
    bone = np.any([image.kept["path_mm"]["cortical_bone"] > 0 for image in images], axis=0) | trabecular
    assert (images[0].pixels[trabecular] != images[1].pixels[trabecular]).mean() > 0.5
    one, two = (image.kept["path_mm"] for image in images)
    near = binary_dilation(bone, iterations=2)
    # Cortical unevenness and roughness also depend on the seed; soft tissue adapts to the rougher bone surface.
    for material in set(one) - {"trabecular_bone", "cortical_bone"}:
        difference = np.abs(one[material] - two[material])[~near]
        assert np.quantile(difference, 0.99) < 2.0
        assert difference.mean() < 0.1
    # The adapted soft tissue changes the signal beside bones by less than noise.
    outside = np.array([image.pixels[~near].astype(np.float64) for image in images])
    assert np.median(np.abs(outside[0] / outside[1] - 1)) < RELATIVE_TOLERANCE


def test_a_sampled_focal_spot_causes_depth_dependent_blur(small):
    # Each of two plates covers half of the image; one plate is near the detector, the other far from it.
    widths = []
    for y_mm in (-100.0, 60.0):
        plate = trimesh.creation.box((40.0, 1.0, 80.0)).apply_translation((20.0, y_mm, 0.0))
        scene = pssf.Scene([pssf.Surface(plate, inside="cortical_bone", outside="air", name="plate")])
        fine = dataclasses.replace(
            small, rows=3, cols=121, pixel_mm=0.02, focal_spot="sampled", focal_spot_mm=1.2, scatter="none",
            detector_blur="none", noise="none",
        )  # fmt: skip
        kev = pssf.simulate(scene, fine, engine="scanline", keep=("primary",)).kept["primary"][1]
        fraction = (kev - kev.min()) / np.ptp(kev)
        inside = (fraction > 0.01) & (fraction < 0.99)
        widths.append(inside.sum() * fine.pixel_mm)
    # Three focal points cause edges at 0.11 and 0.89 of the penumbra a (m - 1); their distance is measured.
    for width, y_mm in zip(widths, (-100.0, 60.0), strict=True):
        penumbra = 1.2 * (1150.0 / (950.0 + y_mm) - 1)
        assert width == pytest.approx(np.sqrt(0.6) * penumbra, abs=0.07)


def test_monte_carlo_scatter_agrees_with_the_kernel(built, small):
    slow = dataclasses.replace(small, scatter="monte_carlo", scatter_photons=1_000_000)
    few = dataclasses.replace(slow, scatter_photons=100_000)
    assert_array_equal(*(pssf.simulate(built, few, rng=3, workers=w).pixels for w in (1, 2)))
    one = pssf.simulate(built, slow, rng=3, keep=("scatter",), workers=2)
    fast = pssf.simulate(built, small, keep=("scatter",))
    middle = np.s_[96:160, 104:152]
    assert 0.005 < one.kept["scatter_error"] < 0.1
    # The statistical error of the mean over cells is 0.3 %; the kernel agrees with the mean within 5 %.
    assert one.kept["scatter"][middle].mean() / fast.kept["scatter"][middle].mean() == pytest.approx(1, abs=0.06)


def test_a_grid_removes_most_scatter_and_some_primary(built, small):
    kept = [
        pssf.simulate(built, dataclasses.replace(small, grid_ratio=ratio), keep=("primary", "scatter")).kept
        for ratio in (0.0, 10.0)
    ]
    middle = np.s_[96:160, 104:152]
    primary, scatter = (kept[1][name][middle].mean() / kept[0][name][middle].mean() for name in ("primary", "scatter"))
    assert 0.6 < primary < 0.8
    assert scatter < primary / 3


def test_without_scatter_a_grid_affects_only_the_primary(built, small):
    bare = dataclasses.replace(small, scatter="none", grid_ratio=8.0)
    assert "scatter" not in pssf.simulate(built, bare, keep=("primary", "scatter")).kept


def test_noise_falls_less_with_frequency_than_the_squared_mtf(small):
    flat = dataclasses.replace(small, pixel_mm=0.15, rows=512, cols=512, scatter="none", focal_spot_mm=0.0, mas=1.0)
    image = LatentImage(path_mm={})
    run_stages(image, StageContext(technique=resolve_technique(flat), seed=1))
    pixels = image.pixels.astype(float)
    power = np.abs(np.fft.fft2(pixels - pixels.mean())) ** 2
    f = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(512, 0.15)]))
    low, high = (power[abs(f - at) < 0.1].mean() for at in (0.4, 2.0))
    # From 0.4/mm to 2/mm the squared MTF decreases by a factor of 10.5, the noise by less than half of this factor.
    assert 3.5 < low / high < 6


def test_path_lengths_are_reused_for_protocols_of_the_same_geometry(built, scene, small):
    paths = pssf.trace(scene, small, engine="scanline")
    before = {name: lengths.copy() for name, lengths in paths.path_mm.items()}
    for protocol in (
        small,
        dataclasses.replace(small, mas=0.5, grid_ratio=8.0),
        dataclasses.replace(small, noise="none"),
    ):
        shared = pssf.simulate(built, protocol, rng=3, engine="scanline", paths=paths)
        alone = pssf.simulate(built, protocol, rng=3, engine="scanline")
        assert_array_equal(shared.pixels, alone.pixels)
        assert shared.audit == alone.audit
    for name, lengths in paths.path_mm.items():
        assert_array_equal(lengths, before[name])


@pytest.mark.parametrize("changed", [{"sdd_mm": 1300.0}, {"rows": 200}, {"texture": "none"}])
def test_path_lengths_of_another_view_or_texture_raise_an_error(built, scene, small, changed):
    paths = pssf.trace(scene, dataclasses.replace(small, **changed), engine="scanline")
    with pytest.raises(pssf.InputError, match=r"^paths must "):
        pssf.simulate(built, small, paths=paths)


@pytest.mark.parametrize(("name", "value"), [("engine", "foo"), ("workers", 0), ("rng", -1), ("keep", ("foo",))])
def test_invalid_arguments_raise_an_error_before_a_knee_is_built(name, value, monkeypatch):
    monkeypatch.setattr("pssf.simulation.build", lambda knee: pytest.fail("built"))
    with pytest.raises(pssf.InputError, match=f"{name} (= |must be)"):
        pssf.simulate(pssf.Knee(), pssf.load_protocol("reference"), **{name: value})


def test_path_lengths_of_another_knee_raise_an_error(built, small):
    other = build_once(dataclasses.replace(built.knee, jsw_medial_mm=5.0))
    paths = pssf.trace(other.scene, small, engine="scanline")
    with pytest.raises(pssf.InputError, match="paths must belong to the simulated scene"):
        pssf.simulate(built, small, paths=paths)
    with pytest.raises(pssf.InputError, match=r"simulate: keywords must be among .*, got 'scene'"):
        pssf.simulate(built.knee, small, scene=other.scene)


def test_a_built_knee_is_simulated_with_its_own_labels(built, small):
    other = build_once(dataclasses.replace(built.knee, jsw_medial_mm=5.0))
    for one in (built, other):
        radiograph = pssf.simulate(one, small, engine="scanline")
        assert radiograph.knee is one.knee
        assert radiograph.truth == one.truth(small)
        assert radiograph.truth.jsw_medial_mm == pytest.approx(one.knee.jsw_medial_mm, abs=1e-3)
        assert one.measure_jsw_mm(pssf.load_protocol("reference"))[0] == pytest.approx(one.knee.jsw_medial_mm, abs=1e-3)


def test_radiographs_are_compared_by_pixels_and_parameters(built, small):
    one, same = (pssf.simulate(built, small, rng=2, engine="scanline", keep=("primary",)) for _ in range(2))
    other = pssf.simulate(built, small, rng=3, engine="scanline")
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one != "radiograph"
    assert one != dataclasses.replace(one, protocol=dataclasses.replace(small, name="renamed"))


def test_repr_of_radiograph_knee_and_truth_contains_no_arrays(built, small):
    radiograph = pssf.simulate(built, small, engine="scanline", keep=("primary", "masks", "path_mm"))
    for text in (repr(radiograph), repr(built), repr(radiograph.truth)):
        assert "array" not in text
        # The text contains each field of protocol, knee and truth once.
        assert len(text) < 5000
