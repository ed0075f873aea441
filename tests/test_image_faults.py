"""Check warnings and errors of `simulate`: alloys, ambient material, field of view, saturation and landmarks."""

import dataclasses
import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf.data.anatomy.tissue_table import load_tissues
from pssf.xray.alloys import describe_alloy_misreading
from pssf.xray.materials import attenuation_per_mm, resolve_material

ENERGIES = np.array([30.0, 50.0, 70.0])


def make_box(x_mm=0.0, side_mm=40.0):
    return trimesh.creation.box((side_mm, side_mm, side_mm)).apply_translation((x_mm, 0, 0))


def simulate_warnings(subject, protocol, **options):
    """Simulate and return the messages of all image warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pssf.simulate(subject, protocol, engine="scanline", **options)
    return [str(one.message) for one in caught if issubclass(one.category, pssf.ImageNotice)]


@pytest.fixture(scope="module")
def coarse():
    return pssf.load_protocol("reference").resample(96)


@pytest.mark.parametrize(
    ("name", "suggested"),
    [
        ("Ti6Al4V@4.43", "titanium_alloy"), ("Ti3Al2.5V@4.48", "titanium_alloy"), ("CoCr28Mo6@8.3", "cobalt_chromium"),
        ("Co28Cr6Mo@8.3", "cobalt_chromium"), ("CoCrMo@8.3", "cobalt_chromium"), ("CoCr@8.3", "cobalt_chromium"),
        ("Fe18Cr14Ni2.5Mo@7.95", "stainless_steel"), ("Fe18Cr14NiC@7.9", "stainless_steel"), ("Ti6Al7Nb@4.52", ""),
        ("Ti13Nb13Zr@5", ""), ("CuZn37@8.4", ""), ("AlMg3@2.7", ""), ("Zr2.5Nb@6.5", ""),
    ],
)  # fmt: skip
def test_an_alloy_formula_with_mass_percentages_gives_a_warning(name, suggested):
    warning = describe_alloy_misreading(name, load_tissues())
    assert warning.startswith(f"{name} is interpreted as numbers of atoms")
    assert "percent by mass, as in Ti=90,Al=6,V=4@4.43" in warning
    assert f"material {suggested} (" in warning if suggested else "material" not in warning


@pytest.mark.parametrize(
    "name",
    [
        "NiTi@6.45", "CsI@4.51", "CaCO3@2.71", "Ca10P6O26H2@3.16", "Gd2O2S@7.3", "BaSO4@4.5", "Ti@4.51", "Fe3C@7.7",
        "C5H8O2@1.18", "Ti86.2Al10.2V3.6@4.43", "Ti=90,Al=6,V=4@4.43", "titanium_alloy", "Gypsum", "Polyethylene@0.94",
    ],
)  # fmt: skip
def test_compounds_and_tissues_give_no_alloy_warning(name):
    assert describe_alloy_misreading(name, load_tissues()) is None


def test_an_alloy_specified_by_mass_attenuates_like_the_tabulated_alloy():
    written = attenuation_per_mm(resolve_material("Ti=90,Al=6,V=4@4.43", load_tissues()), ENERGIES)
    assert_allclose(
        written, attenuation_per_mm(resolve_material("titanium_alloy", load_tissues()), ENERGIES), rtol=1e-12
    )
    assert (attenuation_per_mm(resolve_material("Ti6Al4V@4.43", load_tissues()), ENERGIES) < 0.95 * written).all()


@given(st.lists(st.floats(0.1, 100.0), min_size=2, max_size=4))
def test_attenuation_of_an_alloy_is_weighted_by_mass_percent(parts):
    percents = [100 * part / sum(parts) for part in parts]
    symbols = ("Ca", "O", "Zr", "H")[: len(parts)]
    name = ",".join(f"{symbol}={percent}" for symbol, percent in zip(symbols, percents, strict=True)) + "@2"
    pure = [attenuation_per_mm(resolve_material(f"{symbol}@2", load_tissues()), ENERGIES) for symbol in symbols]
    mixed = sum(percent / 100 * one for percent, one in zip(percents, pure, strict=True))
    assert_allclose(attenuation_per_mm(resolve_material(name, load_tissues()), ENERGIES), mixed, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Ti=90,Al=6@4.43", "must add up to 100, got 96"), ("Ti=90,Xx=10@4", "got 'Xx=10'"), ("Ti=a@4", "got 'Ti=a'"),
        ("Ti=50,Ti=50@4", "once"), ("Ti=-10,Al=110@4", "percent by mass of Ti"), ("Ti=nan@4", "percent by mass of Ti"),
        ("Ti=100@", "material"), ("=100@4", "got '=100'"),
    ],
)  # fmt: skip
def test_invalid_mass_percentages_give_a_one_line_error(name, why):
    with pytest.raises(pssf.InputError, match=why) as error:
        resolve_material(name, load_tissues())
    assert "\n" not in str(error.value)


def test_simulate_warns_once_if_an_alloy_is_interpreted_by_atoms(coarse):
    scene = pssf.Scene([pssf.Surface(make_box(), "Ti6Al4V@4.43", "air", "plate")])
    assert ["titanium_alloy" in one for one in simulate_warnings(scene, coarse)] == [True]


@pytest.mark.parametrize("ambient", ["water", "trabecular_bone", "H2O@1"])
def test_an_attenuating_ambient_material_is_rejected(coarse, ambient):
    scene = pssf.Scene([pssf.Surface(make_box(), "Ti@4.51", ambient)], ambient=ambient)
    with pytest.raises(pssf.InputError, match=f"ambient must be air or another gas, got '{ambient}'"):
        pssf.simulate(scene, coarse, engine="scanline")
    assert "simulate would raise an error" in str(pssf.check(scene))


@pytest.mark.parametrize("ambient", ["air", "Carbon Dioxide", "He@0.00018"])
def test_gases_are_allowed_as_ambient_material(coarse, ambient):
    scene = pssf.Scene([pssf.Surface(make_box(), "muscle", ambient)], ambient=ambient)
    assert simulate_warnings(scene, coarse) == []
    assert str(pssf.check(scene)) == "no faults"


def test_simulate_warns_once_about_a_scene_outside_the_field_of_view(coarse):
    scene = pssf.Scene([pssf.Surface(make_box(900.0), "muscle", "air")])
    (warning,) = simulate_warnings(scene, coarse)
    assert warning.startswith("the scene is outside the field of view")


def test_simulate_warns_about_a_scene_behind_the_collimator(coarse):
    scene = pssf.Scene([pssf.Surface(make_box(100.0), "muscle", "air")])
    assert simulate_warnings(scene, coarse) == []
    (warning,) = simulate_warnings(scene, dataclasses.replace(coarse, field_width_mm=100.0, field_height_mm=240.0))
    assert warning.startswith("the scene is outside the field of view")


def test_simulate_warns_about_saturation_only_inside_the_limb(built, coarse):
    assert simulate_warnings(built, dataclasses.replace(coarse, mas=4.0)) == []
    (warning,) = simulate_warnings(built, dataclasses.replace(coarse, mas=20.0))
    assert "% of the object's pixels are saturated (65535 DN)" in warning
    assert "mas (now 20)" in warning


def test_simulate_warns_about_landmarks_outside_the_image_or_field(built, coarse):
    crop = dataclasses.replace(coarse, rows=20, cols=20)
    (warning,) = simulate_warnings(built, crop)
    assert "landmarks are outside the image (" in warning
    (warning,) = simulate_warnings(built, dataclasses.replace(coarse, field_width_mm=60.0, field_height_mm=240.0))
    assert "landmarks are outside the irradiated field (" in warning
    assert simulate_warnings(built, dataclasses.replace(coarse, field_width_mm=180.0, field_height_mm=240.0)) == []


def test_a_knee_outside_the_field_of_view_gives_one_warning(built, coarse):
    (warning,) = simulate_warnings(built, dataclasses.replace(coarse, rows=16, cols=16, centre_x_mm=150.0))
    assert warning.startswith("the scene is outside")


def test_an_image_warning_points_to_the_calling_file(coarse):
    with pytest.warns(pssf.ImageNotice) as caught:
        pssf.simulate(pssf.Scene([pssf.Surface(make_box(900.0), "muscle", "air")]), coarse, engine="scanline")
    assert caught[0].filename == __file__
