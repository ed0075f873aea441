"""Check the functions behind `pssf validate`: numerical error, run time, morphometry and localisation rates."""

import csv
import dataclasses
import subprocess
import sys
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from conftest import build_once
from numpy.testing import assert_allclose

from pssf import InputError, Knee, load_protocol, validation
from pssf.cohort import plan_cohort
from pssf.data.analysis.reference_table import load_reference_tables
from pssf.geometry.view import resolve_view
from pssf.study import StudySettings
from pssf.validation import validation_figure
from pssf.validation.imaging import left_out_tissues, stage_errors, stage_times, throughput
from pssf.validation.knees import build_success, morphometry, trabecular_error
from pssf.validation.raycasting import (
    engine_agreement,
    raycast_engines,
    sphere_phantoms,
    tessellation_error,
)
from pssf.validation.study_methods import localisation_rates, study_ablation


def test_both_engines_match_exact_chords_of_polyhedra():
    rows = raycast_engines.measure_engines(2, triangles=(1000,), sides=(64, 128), runs=1)
    assert {(row["engine"], row["precision"]) for row in rows} == {
        (engine, precision) for engine in ("embree", "scanline") for precision in ("float32", "float64")
    }
    for row in rows:
        assert row["engine_error_mm"] < (1e-5 if row["precision"] == "float32" else 1e-9)
        assert row["differs_mm"] < 1e-5
        assert row["leaked"] == 0
        assert row["seconds"] > 0
        assert 50 < row["peak_mb"] < 5000


@pytest.mark.slow
def test_no_ray_through_nested_spheroids_remains_unrepaired():
    rows = raycast_engines.measure_nested_spheroids(2, runs=1)
    assert [row["engine"] for row in rows] == ["embree", "embree", "scanline", "scanline"]
    assert not any(row["unrepaired"] for row in rows)


def test_the_growth_exponent_is_1_if_time_is_proportional_to_pixels():
    rows = [
        {"engine": "scanline", "triangles": 100_000, "pixels": pixels, "precision": "float32", "seconds": seconds}
        for pixels, seconds in ((1000, 0.1), (4000, 0.4), (16000, 0.8))
    ]
    found = [row for row in validation.compute_growth_exponents(rows) if row["grows_with"] == "pixels"]
    assert [row["exponent"] for row in found] == [1.0, 0.5]


def test_both_engines_agree_on_random_knees_from_random_directions():
    rows = engine_agreement.compare_engines(3, 2, side_px=192)
    assert [row["knee"] for row in rows] == [0, 1, 2]
    for row in rows:
        assert row["differs_mm"] < 2e-4
        assert row["unrepaired"] == 0
    assert rows[-1]["rays_so_far"] == sum(row["rays"] for row in rows)


@pytest.mark.parametrize("triangles", [1000, 20_000])
def test_a_sphere_polyhedron_is_closed_convex_and_near_its_triangle_count(triangles):
    mesh = sphere_phantoms.make_sphere_polyhedron(triangles, 60.0)
    assert abs(len(mesh.faces) / triangles - 1) < 0.1
    assert mesh.is_watertight
    assert mesh.is_convex
    assert 0.95 < mesh.volume / (4 / 3 * np.pi * 60**3) < 1


def test_the_chord_through_the_middle_of_a_box_equals_its_depth():
    box = trimesh.creation.box(extents=(20, 30, 20))
    view = resolve_view(dataclasses.replace(load_protocol("reference"), rows=3, cols=3, pixel_mm=50.0))
    middle = np.array([[1, 1], [0, 0]])
    assert_allclose(sphere_phantoms.polyhedron_chords_mm(box, middle, view), [30.0, 0.0], rtol=1e-12)
    assert_allclose(sphere_phantoms.sphere_chords_mm(15.0, middle, view), [30.0, 0.0], rtol=1e-12)


def test_the_pareto_front_contains_only_points_that_none_dominates():
    points = [(1.0, 5.0), (2.0, 3.0), (2.5, 4.0), (3.0, 3.0), (9.0, 1.0)]
    assert validation_figure.find_pareto_front(points) == [(1.0, 5.0), (2.0, 3.0), (9.0, 1.0)]


def test_the_validation_figure_is_a_png():
    row = {"engine_error_mm": 1e-6, "tessellation_rms_mm": 0.1, "seconds": 0.1, "triangles": 1000, "pixels": 65536}
    rows = [{**row, "engine": e, "precision": p} for e in ("embree", "scanline") for p in ("float32", "float64")]
    assert validation_figure.plot_error_against_time(rows).startswith(b"\x89PNG")


@pytest.mark.slow  # Radiographs with each tolerance are compared with the whole spectrum.
def test_a_smaller_spectrum_tolerance_needs_more_energies_and_is_met():
    rows = stage_times.measure_spectrum_nodes((1e-2, 1e-4, 1e-6))
    assert [row["used"] for row in rows] == [False, True, False]
    assert rows[0]["nodes"] < rows[1]["nodes"] < rows[2]["nodes"]
    for row in rows:
        assert row["max_relative_error"] <= row["tolerance"]


@pytest.mark.slow
def test_the_tessellation_error_of_bones_is_below_0_02_mm_rms(monkeypatch):
    monkeypatch.setattr(tessellation_error, "_REFERENCE_TOLERANCE_MM", 0.008)
    rows = tessellation_error.measure_tessellation_error(coarse_tolerances_mm=(0.1,), refinement_factors=())
    for bone in ("femur", "tibia"):
        of_bone = [row for row in rows if row["bone"] == bone]
        assert all(one["rms_mm"] >= other["rms_mm"] for one, other in pairwise(of_bone))
        assert all(one["triangles"] < other["triangles"] for one, other in pairwise(of_bone))
    for row in (row for row in rows if row["used"]):
        assert row["rms_mm"] < 0.015
        assert row["max_mm"] < 0.06


def test_the_density_integration_error_decreases_with_step_length():
    rows = trabecular_error.measure_integration_steps()
    coarse = [row for row in rows if row["used"]]
    assert [row["turned_deg"] for row in coarse] == [0.0, 5.0, 10.0]
    for row, rms, most in zip(coarse, (0.001, 0.004, 0.006), (0.01, 0.05, 0.08), strict=True):
        assert 0 < row["rms"] < rms
        assert 0 < row["texture"] < most
    for first, second in pairwise(rows):
        assert second["step_mm"] > first["step_mm"] or second["rms"] < 0.6 * first["rms"]


def test_density_integrals_take_part_of_the_ray_casting_time(monkeypatch):
    small = {"rows": 128, "cols": 128, "pixel_mm": 2.0}
    monkeypatch.setattr(
        trabecular_error, "load_protocol", lambda name: dataclasses.replace(load_protocol(name), **small)
    )
    rows = trabecular_error.measure_texture_cost()
    assert [row["engine"] for row in rows] == ["embree", "scanline"]
    assert rows[0]["samples"] == rows[1]["samples"] > 0
    assert all(0 < row["time_fraction"] < 1 and row["ns"] > 0 for row in rows)


def test_measured_texture_matches_the_spectrum_of_a_synthetic_field():
    rng = np.random.default_rng(1)
    f = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(256, 0.1)]))
    spectrum = np.fft.fft2(rng.standard_normal((256, 256))) * np.where(f > 0, np.maximum(f, 1e-9) ** -1.0, 0)
    field = np.fft.ifft2(spectrum).real
    found = trabecular_error.measure_texture(100 + 3 * field / field.std(), 0.1)
    assert found["slope_0.2_2"] == pytest.approx(-2.0, abs=0.15)
    assert found["vertical_over_horizontal"] == pytest.approx(1.0, abs=0.25)
    # For a spectrum of 1 / f^2, integrated over rings: ln(3 / 2) / (3^2 - 2^2) over ln(0.8 / 0.4) / (0.8^2 - 0.4^2).
    assert found["fine_over_coarse"] == pytest.approx(np.log(1.5) / 5 * 0.48 / np.log(2), rel=0.25)
    assert "fine_over_coarse" not in trabecular_error.measure_texture(100 + field, 0.2)
    stripes = trabecular_error.measure_texture(
        100 + 3 * np.cos(2 * np.pi * 0.8 * 0.1 * np.arange(256)) + field[:, :], 0.1
    )
    assert stripes["vertical_over_horizontal"] > 3


@pytest.fixture(scope="module")
def sampled_texture():
    return {row["quantity"]: row for row in trabecular_error.compare_texture_with_patients(24, 1)}


# Quantum noise at 2 mAs masks the texture above 0.8/mm, so the slope is flatter than in patient radiographs.
_NOISY = pytest.mark.xfail(
    strict=True, reason="slope above 0.8/mm is -3.7 with detector noise; patient radiographs have -4.4 to -4.0"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "quantity",
    [pytest.param(name, marks=_NOISY) if name == "slope_0.8_2" else name for name in load_reference_tables().texture],
)
def test_texture_of_sampled_grade_0_knees_matches_patient_radiographs(sampled_texture, quantity):
    row = sampled_texture[quantity]
    # The mean must be within the patient range, widened by a sampling margin of 1.6 standard errors.
    margin = 1.6 * (row["p90"] - row["p10"]) / 2.56 / np.sqrt(row["knees"])
    assert row["real_low"] - margin <= row["mean"] <= row["real_high"] + margin


@pytest.mark.slow
def test_sizes_of_sampled_knees_agree_with_the_literature():
    rows = morphometry.compare_sizes_with_literature(8, 1)
    labels = {row["quantity"]: row["value"] for row in rows if not row["reference"]}
    assert labels["error of jsw_medial_mm"] < 1e-3
    assert labels["error of varus_deg"] < 0.1
    sizes = [row for row in rows if row["reference"]]
    assert len(sizes) > 30
    # The bound of 1.5 SD allows half an SD of bias and two standard errors (1.0 SD) of the mean of four knees per sex.
    # If patient bones differ from the literature, agreement with either reference is sufficient.
    for row in sizes:
        known = [row["reference"]] + ([row["patients"]] if row["patients"] != "" else [])
        assert min(abs(row["value"] - size) for size in known) < 1.5 * row["reference_sd"], row


def test_sampled_knees_can_be_built():
    messages: list[str] = []
    (row,) = build_success.measure_knee_builds(2, 1, messages.append)
    assert messages == [f"builds: {done} of 2 knees, 0 could not be built" for done in (1, 2)]
    assert -1e-6 < row["min_path_mm"] <= 0
    assert (row["built"], row["failed"], row["first_error"]) == (2, 0, "")
    assert row["jsw_error_mm"] < 1e-3
    # The upper bound is 260,000 triangles plus about 4,000 for skin folds.
    assert 100_000 < row["min_triangles"] <= row["max_triangles"] < 264_000


def test_a_validation_run_writes_the_requested_tables(tmp_path, monkeypatch):
    names = ("measure_spectrum_nodes", "measure_cold_and_warm_runs", "compare_physics_with_references")
    for name in (*names, "compare_sizes_with_literature", "compare_engines"):
        monkeypatch.setattr(validation, name, lambda *a: [{"a": 1, "b": 2.5}])
    messages = []
    requested = ("spectrum", "stages", "agreement")
    paths = validation.run_validation(tmp_path / "out", workers=1, tables=requested, progress=messages.append)
    assert [p.name for p in paths] == ["stages.csv", "agreement.csv", "spectrum.csv", "machine.json"]
    assert messages == ["stages", "agreement", "spectrum"]
    with open(paths[0]) as handle:
        assert list(csv.DictReader(handle)) == [{"a": "1", "b": "2.5"}]


def test_throughput_is_measured_for_new_knees_and_other_acquisitions(monkeypatch):
    monkeypatch.setattr(throughput, "build", build_once)
    monkeypatch.setattr(throughput, "sample_knee", lambda **_: Knee(jsw_definition="read"))
    new, other = throughput._measure_matrix(64, 1)
    assert [row["case"] for row in (new, other)] == ["new knee", "another acquisition"]
    for row in (new, other):
        parts = sum(row[f"{part}_seconds"] for part in ("build", "ray", "label", "other"))
        assert 0 < row["cpu_seconds"] < 2 * parts
        assert row["images_per_minute"] == pytest.approx(60 / row["cpu_seconds"], rel=0.02)
        assert 0.008 < row["disk_mb"] < 0.1


def test_one_worker_and_two_workers_make_the_same_images(monkeypatch):
    made = []

    def run(function, items, *, shared, workers):
        assert (function, workers) == (throughput._make_images, 2)
        made.append([[knee.texture_seed for knee in item] for item in items])

    monkeypatch.setattr(throughput, "map_in_parallel", run)
    one, two = throughput.measure_worker_scaling(5)
    _, alone, shared = made
    assert alone[1] == []
    assert sorted(alone[0]) == sorted(shared[0] + shared[1])
    assert abs(len(shared[0]) - len(shared[1])) == 1
    assert (one["workers"], two["workers"], one["ratio"]) == (1, 2, 1.0)


def test_a_tissue_that_is_left_out_changes_the_image_where_it_attenuates(monkeypatch):
    monkeypatch.setattr(left_out_tissues, "_MATRICES", (64,))
    monkeypatch.setattr(left_out_tissues, "build", build_once)
    monkeypatch.setattr(left_out_tissues, "sample_numbered_knee", lambda _: (Knee(jsw_definition="read"), None))
    monkeypatch.setattr(left_out_tissues, "_TISSUES", {**left_out_tissues._TISSUES, "nothing": ()})
    rows = {row["tissue"]: row for row in left_out_tissues.measure_left_out_tissues(1)}
    assert rows["nothing"]["max_rms"] == rows["nothing"]["largest"] == 0
    assert rows["fat between muscles"]["median_rms"] > 10 * rows["menisci"]["median_rms"] > 0
    assert 1e-4 < rows["menisci"]["noise_rms"] < 0.01
    for row in rows.values():
        assert row["largest"] >= row["max_rms"] >= row["median_rms"]


def test_an_unknown_validation_table_is_rejected(tmp_path):
    with pytest.raises(InputError, match=r"table must be one of .*, got 'engine' \(did you mean 'engines'\?\)"):
        validation.run_validation(tmp_path, tables=("engine",))


@pytest.mark.slow
def test_cold_and_warm_runs_are_timed_in_separate_processes():
    rows = stage_times.measure_cold_and_warm_runs(2)
    runs = {row["run"]: row for row in rows if row["engine"] == "embree"}
    assert list(runs) == ["cold", "first", "second"]
    # Only the cold run computes the SpekPy spectrum.
    assert runs["cold"]["spectrum"] > 10 * runs["first"]["spectrum"]


def test_a_cold_run_starts_with_empty_caches_and_writes_bytecode(tmp_path, monkeypatch):
    for name in ("NUMBA_CACHE_DIR", "PSSF_CACHE_DIR", "PYTHONPYCACHEPREFIX"):
        monkeypatch.setenv(name, "elsewhere")
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    code = (
        "import sys, numba\nfrom pssf.data.array_cache import _cache_folder\n"
        "print(sys.dont_write_bytecode, sys.pycache_prefix, numba.config.CACHE_DIR, _cache_folder(), sep='\\n')"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, env=stage_times._make_cache_environment(tmp_path), capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", *(str(tmp_path / name) for name in ("bytecode", "numba", "pssf"))]


@pytest.mark.slow
def test_the_time_and_error_of_each_imaging_stage_are_measured(monkeypatch, small):
    protocol = dataclasses.replace(small, rows=512, cols=512, pixel_mm=0.6)
    monkeypatch.setattr(stage_errors, "load_protocol", lambda name: protocol)
    monkeypatch.setattr(stage_errors, "_PHOTONS", 1_000_000)
    monkeypatch.setattr(stage_errors, "_RUNS", 1)
    rows = {row["stage"]: row for row in stage_errors.measure_imaging_chain(2)}
    assert set(rows) >= {"rays", "attenuation", "scatter", "focal spot", "quantum noise", "detector blur", "readout"}
    for engine in ("scanline", "embree"):
        assert sum(row[f"{engine}_time_fraction"] for row in rows.values()) == pytest.approx(1, abs=0.01)
    assert rows["rays"]["error"] < 1e-5
    assert rows["attenuation"]["error"] < 1e-3
    assert rows["scatter"]["error"] < 0.08
    assert rows["detector blur"]["error"] < 0.02


def test_every_ablation_is_accepted_by_the_study(tmp_path):
    for case in study_ablation.ABLATION_CASES:
        plan_cohort("quick", seed=0, overrides={**study_ablation._COHORT, **case.cohort})
        StudySettings(**case.settings)
        if case.protocol_toml:
            path = study_ablation._write_protocol_variant(tmp_path, "low_dose", case.protocol_toml)
            plain, changed = load_protocol("low_dose"), load_protocol(path)
            assert changed != plain
            assert (changed.name, changed.mas) == ("low_dose", plain.mas)


def test_ablation_times_are_fractions_of_the_full_study_time(monkeypatch):
    seconds = iter([9.0, 60.0, 30.0, 15.0, 3.0])
    timed_cases = []

    def time_case(out, case, workers):
        timed_cases.append((out.name, case.omitted))
        return 27, next(seconds)

    monkeypatch.setattr(study_ablation, "_time_case", time_case)
    rows = study_ablation.measure_ablations(2, study_ablation.ABLATION_CASES[:3])
    assert [row["time_fraction"] for row in rows] == [1.0, 0.5, 0.25, 0.05]
    assert [name for name, _ in timed_cases] == ["warm", "0", "1", "2", "0"]


def make_location_row(case, status, kind="study", **measures):
    usual = dict.fromkeys(localisation_rates._MEASURES, 0.9) | {"scale": 1.0, "match_distance_mm": 1.0}
    return {"case": case, "kind": kind, "status": status, "error_mm": 0.5, **usual, **measures}


def test_localisation_limits_separate_correct_from_simulated_errors(monkeypatch):
    made = [make_location_row("right", "found", scale=scale) for scale in (0.8, 1.0)]
    made += [
        make_location_row("without bones", "no knee", score=both, mean_score=both, orientation_evidence=-0.1)
        for both in (0.3, 0.4)
    ]
    made += [make_location_row("wrong side", "wrong side", side_evidence=-0.08)]
    made += [make_location_row("right, no pitch", "found", mean_score=0.6)]
    made += [make_location_row("without bones, no pitch", "no knee", mean_score=0.45, side_evidence=-0.3)]
    made += [
        make_location_row("pitch x 1.5", "wrong scale", scale=1.44),
        make_location_row("pitch x 0.5", "wrong scale", scale=0.2),
    ]
    monkeypatch.setattr(localisation_rates, "_locate_all_knees", lambda count, workers, modes, table: made)
    limits = {row["limit"]: row["simulations"] for row in localisation_rates.derive_localisation_limits(2, 1)}
    assert limits == {
        "min_score": 0.4, "min_score_unknown_pitch": 0.45, "min_side_evidence_unknown_pitch": 0.3,
        "min_score_square_pixels": 0.45, "min_score_stop_search": 0.6, "max_opposite_side_evidence": 0.08,
        "max_upside_down_evidence": 0.1, "max_match_distance_mm": 1.0, "scale, least": 0.4, "scale, greatest": 1.2,
    }  # fmt: skip
    rows = {row["case"]: row for row in localisation_rates.measure_localisation(2, 1)}
    assert (rows["right"]["found"], rows["right"]["mean_error_mm"]) == (2, 0.5)
    assert (rows["without bones"]["found"], rows["without bones"]["as_meant"]) == (0, 2)
    assert (rows["without bones"]["least_score"], rows["without bones"]["most_score"]) == (0.3, 0.4)


def test_a_knee_is_located_in_every_localisation_case(monkeypatch):
    located = []

    def find(case, pixels, knee, protocol, templates, table):
        located.append((case, pixels.mean()))
        return SimpleNamespace(row=0.0, col=0.0, status="found", **dict.fromkeys(localisation_rates._MEASURES, 0.0))

    monkeypatch.setattr(localisation_rates, "_locate_joint", find)
    monkeypatch.setattr(localisation_rates, "_SIDE_PX", 64)
    rows = localisation_rates._locate_knee_in_all_cases(0, templates=(), modes=0, table=None)
    assert [row["case"] for row in rows] == list(localisation_rates._CASES)
    means = dict(located)
    assert means[localisation_rates._CASES["without bones"]] > means[localisation_rates._CASES["right"]]
    assert rows[0]["error_mm"] > 100
