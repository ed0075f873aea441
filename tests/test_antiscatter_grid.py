"""Check the transmission of primary and scattered radiation through anti-scatter grids."""

import dataclasses

import numpy as np
import pytest

import pssf
from pssf.scatter import antiscatter_grid
from pssf.scatter.antiscatter_grid import Grid, compute_scatter_transmission, transmit_through_grid
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.spectrum import compute_beam


@pytest.fixture(scope="module")
def technique():
    return resolve_technique(pssf.load_protocol("reference"))


@pytest.fixture(scope="module")
def beam(technique):
    return compute_beam(technique)


def compute_primary_transmission(grid, beam):
    """Return the fraction of the primary signal that passes a grid."""
    weight = beam.signal_kev
    return (transmit_through_grid(grid, beam).photons_per_mm2 * weight).sum() / (beam.photons_per_mm2 * weight).sum()


def test_a_10_to_1_grid_improves_primary_to_scatter_at_least_threefold(technique, beam):
    # JHU extremity CBCT (Proc SPIE 8313:831318) reports a factor of about 3; the simulated grid does not scatter.
    for gap_mm in (20.0, 150.0):
        assert (
            3
            < compute_primary_transmission(Grid(), beam)
            / compute_scatter_transmission(Grid(), beam, gap_mm, technique.material("muscle"))
            < 20
        )


def test_grid_primary_transmission_matches_open_area_and_aluminium(beam):
    at_60 = dataclasses.replace(beam, energies_kev=np.array([60.0]), photons_per_mm2=np.ones(1), signal_kev=np.ones(1))
    # 0.8 of the area is open; 2 mm of aluminium at 0.0750 1/mm (NIST: 0.2778 cm2/g).
    assert compute_primary_transmission(Grid(), at_60) == pytest.approx(0.8 * np.exp(-0.15), rel=0.01)


def test_higher_grid_ratios_and_smaller_air_gaps_transmit_less_scatter(technique, beam):
    ratios = [
        compute_scatter_transmission(Grid(ratio=r), beam, 20.0, technique.material("muscle")) for r in (4.0, 8.0, 12.0)
    ]
    gaps = [
        compute_scatter_transmission(Grid(), beam, gap, technique.material("muscle")) for gap in (200.0, 80.0, 10.0)
    ]
    assert ratios == sorted(ratios, reverse=True)
    assert gaps == sorted(gaps, reverse=True)
    assert all(0 < value < 1 for value in ratios + gaps)


def test_scatter_transmission_agrees_with_traced_photons_of_uniform_radiance(technique, beam):
    """The photons have the cosine distribution of uniform radiance; their paths in lead are summed in steps."""
    grid, gap_mm, rng = Grid(), 20.0, np.random.default_rng(0)
    at_60 = dataclasses.replace(beam, energies_kev=np.array([60.0]), photons_per_mm2=np.ones(1), signal_kev=np.ones(1))
    sine, azimuth = np.sqrt(rng.random(60_000)), 2 * np.pi * rng.random(60_000)
    across, along = sine * np.cos(azimuth), sine * np.sin(azimuth)
    down, depth_mm = np.sqrt(1 - sine**2), gap_mm + antiscatter_grid._SCATTER_DEPTH_MM
    from_limb = [
        np.abs(slope / down) * depth_mm < half
        for slope, half in zip((across, along), antiscatter_grid._EXIT_FACE_HALF_SIZE_MM, strict=True)
    ]
    across, down = across[np.logical_and(*from_limb)], down[np.logical_and(*from_limb)]
    period_mm = 10.0 / grid.lines_per_cm
    height_mm = grid.ratio * (period_mm - grid.lead_mm)
    heights_mm = (np.arange(400) + 0.5) / 400 * height_mm
    crossed_mm = rng.random((len(down), 1)) * period_mm + heights_mm * (across / down)[:, None]
    lead_mm = (crossed_mm % period_mm < grid.lead_mm).mean(axis=1) * height_mm / down
    lead, aluminium = antiscatter_grid._strip_attenuation_per_mm(at_60.energies_kev)[:, 0]
    passed = np.exp(-lead * lead_mm - aluminium * (height_mm / down - lead_mm))
    found = compute_scatter_transmission(grid, at_60, gap_mm, technique.material("muscle"))
    assert abs(found - passed.mean()) < 4 * passed.std() / np.sqrt(len(passed))


@pytest.mark.parametrize("setting", [{"ratio": 1.0}, {"lines_per_cm": np.nan}, {"lead_mm": 0.2, "lines_per_cm": 60.0}])
def test_an_impossible_grid_parameter_is_named_in_the_error(setting):
    with pytest.raises(pssf.InputError, match=next(iter(setting)) + r".* must be .*, got "):
        Grid(**setting)
