"""Check radiographs: text, notebook image, exposure index, and errors of `load` for images of other programs."""

import dataclasses
import importlib.metadata
import io

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image

import pssf
from pssf.quality.beam_quality import air_kerma_ugy
from pssf.quality.exposure_index import exposure_index
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.spectrum import tube_spectrum

SMALL = {"rows": 192, "cols": 160, "pixel_mm": 1.6}


def make_protocol(name="reference", **changes):
    return dataclasses.replace(pssf.load_protocol(name), **{**SMALL, **changes})


@pytest.fixture(scope="module")
def radiograph():
    knee = dataclasses.replace(pssf.Knee(side="left"), grade=None)
    return pssf.simulate(knee, make_protocol(), seed=7, engine="scanline", keep=("primary", "scatter", "path_mm"))


def simulate_open_field(**changes):
    """Simulate a flat field; the only object of the scene is far outside the field."""
    box = trimesh.creation.box((10.0, 10.0, 10.0))
    box.apply_translation((0.0, 0.0, 900.0))
    scene = pssf.Scene([pssf.Surface(box, "water", "air")])
    return pssf.simulate(scene, make_protocol(noise="none", **changes), engine="scanline")


def test_repr_of_a_radiograph_is_one_short_line(radiograph):
    text = repr(radiograph)
    assert text == "Radiograph(left knee, reference, 70 kV, 2 mAs, 192 x 160 px of 1.6 mm, seed 7)"
    graded = dataclasses.replace(radiograph, knee=pssf.sample_knee(grade=2, rng=np.random.default_rng(1), side="left"))
    assert "left knee, grade 2, " in repr(graded)
    assert repr(simulate_open_field()).startswith("Radiograph(a scene, reference")
    rod = trimesh.creation.cylinder(radius=3, segment=[[-20, 0, 20], [20, 0, 20]])
    fixed = pssf.build(pssf.Knee()).insert(rod, "titanium_alloy", name="screw")
    assert "right knee, screw, reference" in repr(pssf.simulate(fixed, make_protocol(), engine="scanline"))


def test_the_notebook_png_is_processed_for_display(radiograph):
    with Image.open(io.BytesIO(radiograph._repr_png_())) as picture:
        assert picture.format == "PNG"
        assert picture.size == (160, 192)
        assert np.array_equal(np.asarray(picture), pssf.render_for_display(radiograph, processing="processed"))
    large = dataclasses.replace(radiograph, pixels=np.repeat(np.repeat(radiograph.pixels, 10, 0), 10, 1))
    with Image.open(io.BytesIO(large._repr_png_())) as picture:
        assert max(picture.size) <= 800


def test_show_opens_the_image_processed_for_display(radiograph, monkeypatch):
    images = []
    monkeypatch.setattr(Image.Image, "show", lambda self: images.append(np.asarray(self)))
    radiograph.show()
    assert np.array_equal(images[0], pssf.render_for_display(radiograph, processing="processed"))


@pytest.mark.parametrize("detector", ["csi", "gos"])
@pytest.mark.parametrize("mas", [1.0, 4.0])
def test_exposure_index_of_an_rqa5_field_is_100_times_air_kerma_in_ugy(detector, mas):
    changes = {"tube_kv": 70.0, "filtration_mm_al": 23.5, "anode_angle_deg": 12.0, "mas": mas, "detector": detector}
    flat = simulate_open_field(**changes)
    technique = resolve_technique(flat.protocol)
    energies, photons = tube_spectrum(70.0, 12.0, 23.5)
    kerma_ugy = air_kerma_ugy(technique.material("air"), energies, photons) * mas * (1000 / flat.protocol.sdd_mm) ** 2
    # The tolerance includes the inverse square law, which reduces air kerma towards the corners by up to 2 %.
    assert flat.exposure_index == pytest.approx(100 * kerma_ugy, rel=0.02)


@pytest.mark.parametrize("name", ["reference", "fixed_flexion", "low_dose", "gos_screen"])
def test_the_exposure_index_describes_the_signal_behind_the_limb(name):
    radiograph = pssf.simulate(
        pssf.Knee(), make_protocol(name), engine="scanline", keep=("primary", "scatter", "path_mm")
    )
    limb = sum(radiograph.kept["path_mm"].values()) > 20.0
    signal = radiograph.kept["primary"] + radiograph.kept.get("scatter", 0.0)
    wanted = exposure_index(signal[limb], resolve_technique(radiograph.protocol))
    # The choice of limb pixels changes the index by less than half of the 20 % that IEC 62494-1 allows.
    assert radiograph.exposure_index == pytest.approx(wanted, rel=0.1)


def test_exposure_is_proportional_to_mas_and_preserved_in_files(radiograph, tmp_path):
    double = pssf.simulate(radiograph.knee, make_protocol(mas=1.0), seed=7, engine="scanline")
    assert radiograph.exposure_index == pytest.approx(2 * double.exposure_index, rel=0.01)
    assert radiograph.entrance_air_kerma_ugy == pytest.approx(2 * double.entrance_air_kerma_ugy)
    assert 100 < radiograph.entrance_air_kerma_ugy < 200
    loaded = pssf.load(pssf.save(radiograph, tmp_path / "one.tif"))
    assert loaded.exposure_index == radiograph.exposure_index


def test_the_exposure_index_considers_only_the_collimated_field():
    knee = pssf.Knee()
    whole, part = (
        pssf.simulate(knee, make_protocol(noise="none", scatter="none", **field), engine="scanline")
        for field in ({}, {"field_width_mm": 160.0, "field_height_mm": 120.0})
    )
    # Without scatter, the collimator does not affect the signal inside the field.
    open_collimator = dataclasses.replace(part, pixels=whole.pixels)
    assert part.exposure_index == pytest.approx(open_collimator.exposure_index, rel=0.01)
    black = dataclasses.replace(whole, pixels=part.pixels)
    assert abs(black.exposure_index / part.exposure_index - 1) > 0.1


def test_package_version_equals_the_installed_version():
    assert pssf.__version__ == importlib.metadata.version("pssf")
    assert "__version__" in dir(pssf)


def write_foreign_image(folder, name):
    pixels = np.arange(64 * 64, dtype=np.uint16).reshape(64, 64)
    path = folder / name
    if name.endswith("tif"):
        tifffile.imwrite(path, pixels, metadata={} if name.startswith("described") else None)
    else:
        Image.fromarray((pixels >> 4).astype(np.uint8)).save(path)
    return path


@pytest.mark.parametrize("name", ["plain.tif", "described.tif", "plain.png", "plain.jpg"])
@pytest.mark.parametrize("read", [pssf.load, pssf.load_parameters])
def test_loading_a_foreign_image_raises_an_error_that_names_alternatives(tmp_path, name, read):
    with pytest.raises(
        pssf.InputError, match=r"of another program: use pssf predict, pssf\.features or pssf study --films"
    ) as raised:
        read(write_foreign_image(tmp_path, name))
    assert "\n" not in str(raised.value)
    assert name in str(raised.value)


def test_loading_a_presentation_png_raises_an_error_with_a_remedy(radiograph, tmp_path):
    path = pssf.save(radiograph, tmp_path / "one.png")
    with pytest.raises(pssf.InputError, match="PNG for presentation, which has no linear pixels: use load_parameters"):
        pssf.load(path)
    assert pssf.load_parameters(path)["knee"] == radiograph.knee
