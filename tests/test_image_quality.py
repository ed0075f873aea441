"""Check beam and detector quality: HVL, MTF, noise power spectrum, variance and exposure index."""

import csv
import dataclasses

import numpy as np
import pytest
import xraylib
from numpy.testing import assert_allclose
from tissue_materials import find_material

import pssf
from pssf import quality
from pssf.data.analysis.reference_table import load_reference_tables
from pssf.quality import beam_quality, detector_quality, quality_measurement
from pssf.quality.exposure_index import measure_exposure_quantities
from pssf.xray.resolved_technique import resolve_technique

REFERENCE = pssf.load_protocol("reference")


def test_energy_transfer_to_air_equals_the_tabulated_values():
    # Mass energy-absorption coefficients of dry air in cm2/g (Hubbell and Seltzer 1995), by energy in keV.
    known = {15.0: 1.334, 20.0: 0.5389, 30.0: 0.1537, 40.0: 0.06833, 60.0: 0.03041, 80.0: 0.02407}
    assert_allclose(
        beam_quality.energy_transfer_cm2_per_g(find_material("air"), np.array(list(known))),
        list(known.values()),
        rtol=0.015,
    )


def test_half_value_layers_at_a_single_energy_equal_the_closed_form():
    first, second = beam_quality.half_value_layers_mm_al(find_material("air"), np.array([50.0]), np.array([1e6]))
    expected = np.log(2) / (xraylib.CS_Total(13, 50.0) * 0.2699)
    assert_allclose([first, second], expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["low_kv", "reference", "high_kv"])
def test_beam_quantities_agree_with_an_independent_computation(name):
    values = beam_quality.compute_beam_quantities(resolve_technique(pssf.load_protocol(name)))
    protocol, known = pssf.load_protocol(name), load_reference_tables()
    rows = [
        quality_measurement._make_row(quantity, values[quantity], protocol, known)
        for quantity in quality_measurement._BEAM_QUANTITIES
    ]
    assert_allclose([float(row["value"]) for row in rows], [row["reference"] for row in rows], rtol=0.015)


@pytest.mark.parametrize("kind", ["csi", "gos"])
def test_the_mtf_of_a_slanted_edge_equals_the_model(kind):
    curve = detector_quality.measure_mtf(resolve_technique(dataclasses.replace(REFERENCE, detector=kind)))
    inside = curve.frequency_per_mm < 3.0
    assert_allclose(curve.measured[inside], curve.model[inside], rtol=0.02)


def test_noise_of_flat_fields_has_the_power_spectrum_of_the_model():
    curve = detector_quality.measure_nnps(resolve_technique(REFERENCE))
    # With 96 regions and at least 40 frequencies per ring, 3 standard errors are below 5 % per ring and 1 % overall.
    assert_allclose((curve.measured / curve.model).mean(), 1.0, atol=0.03)
    assert_allclose(curve.measured[2:], curve.model[2:], rtol=0.12)


def test_variance_of_flat_fields_equals_the_photon_transfer_model():
    for mean, measured, expected in detector_quality.measure_photon_transfer(resolve_technique(REFERENCE)):
        # The variance of n = 512 x 512 normal values has a relative standard error of sqrt(2 / n).
        assert_allclose(measured, expected, rtol=5 * np.sqrt(2) / 512)
        assert mean > 0


def test_quality_tables_list_every_quantity_with_its_reference(tmp_path):
    small = dataclasses.replace(REFERENCE, rows=512, cols=512, pixel_mm=0.6)
    found = quality.measure_quality(small)
    paths = quality.write_quality(found, small, tmp_path)
    with open(paths[0]) as handle:
        rows = {row["quantity"]: row for row in csv.DictReader(handle)}
    assert {"hvl1_mm_al", "exposure_index", "spr_bone", "mtf_1_per_mm", "dqe_0.5_per_mm", "dynamic_range"} < set(rows)
    for name in ("mean", "variance", "skewness", "kurtosis"):
        row = rows[f"noise_{name}"]
        assert float(row["low"]) < float(row["value"]) < float(row["high"])
    assert found.spr.shape == (128, 128)
    assert found.spr_cell_mm * 128 == pytest.approx(2048 * 0.15)
    assert found.spr.max() > 1 > found.spr[64, 2]
    assert 150 < float(rows["exposure_index"]["value"]) < 600
    assert rows["hvl1_mm_al"]["reference"] == "2.636"
    assert all(np.isfinite(float(row["value"])) for row in rows.values())
    assert paths[3].read_bytes().startswith(b"\x89PNG")


def test_image_quality_does_not_depend_on_posture_collimation_or_marker():
    flexed = dataclasses.replace(pssf.load_protocol("fixed_flexion"), rows=256, cols=256, pixel_mm=1.2)
    collimated = dataclasses.replace(flexed, field_width_mm=20.0, field_height_mm=20.0, marker="R")
    assert detector_quality.make_bare_technique(
        resolve_technique(collimated), 64
    ) == detector_quality.make_bare_technique(resolve_technique(flexed), 64)
    quantities, _ = measure_exposure_quantities(resolve_technique(flexed))
    assert 150 < quantities["exposure_index"] < 600
