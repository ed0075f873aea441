"""Check the comparison of projected landmarks with patient landmarks: means, spreads, modes and joint gaps."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pssf
from pssf.anatomy.posture.knee_assembly import load_jsw_protocol
from pssf.core.label_names import CONTOUR_LANDMARKS
from pssf.data.analysis.landmark_table import load_landmark_reference
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.model.sampling.knee_sampling import load_knee_distributions, sample_knees
from pssf.patient_comparison.contours import landmark_comparison
from pssf.patient_comparison.contours.cohort_landmarks import load_cohort_landmarks

REFERENCE = load_landmark_reference()


def make_contours(grade=0, count=600, width_mm=77.0, seed=0):
    """Make landmarks with the mean and SD of patients, independently for each landmark."""
    known = REFERENCE.grade[str(grade)]
    noise = np.random.default_rng(seed).standard_normal((count, 16, 2))
    fractions = np.array(known.mean_share) + noise * np.array(known.sd_share)
    return landmark_comparison.LandmarkSample(landmarks_mm=fractions * width_mm, grades=np.full(count, grade))


def transform_points(points_mm, degrees, scale=1.0, shift=(0.0, 0.0)):
    angle = np.deg2rad(degrees)
    return scale * points_mm @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + shift


def test_landmarks_with_patient_statistics_are_within_tolerance():
    found = landmark_comparison.compare_contours(make_contours(), REFERENCE)
    assert found.outside == [{"grade": 0, "knees": 600, "outside": 0, "total": 24}]
    assert len(found.landmarks) == 28
    assert all(row["mean_inside"] and row["sd_inside"] for row in found.landmarks)


def test_only_a_displaced_landmark_is_outside_the_tolerance():
    sample = make_contours()
    moved = sample.landmarks_mm.copy()
    moved[:, CONTOUR_LANDMARKS.index("femur_medial_condyle"), 1] += 77.0 * 0.0135 * 4
    found = landmark_comparison.compare_contours(dataclasses.replace(sample, landmarks_mm=moved), REFERENCE)
    off = [(row["landmark"], row["axis"]) for row in found.landmarks if not row["mean_inside"]]
    assert off == [("femur_medial_condyle", "y")]
    assert found.outside[0]["outside"] == 1
    row = next(row for row in found.landmarks if not row["mean_inside"])
    assert_allclose(row["difference_sd"], 4.0, atol=0.15)


@pytest.mark.parametrize(("stretch", "inside"), [(0.5, False), (0.8, True), (1.3, True), (1.6, False)])
def test_a_spread_ratio_from_0_7_to_1_4_is_within_tolerance(stretch, inside):
    sample = make_contours()
    mean = sample.landmarks_mm.mean(axis=0)
    index = CONTOUR_LANDMARKS.index("medial_spine")
    spread = sample.landmarks_mm.copy()
    spread[:, index] = mean[index] + stretch * (spread[:, index] - mean[index])
    found = landmark_comparison.compare_contours(dataclasses.replace(sample, landmarks_mm=spread), REFERENCE)
    rows = {(row["landmark"], row["axis"]): row for row in found.landmarks}
    assert rows["medial_spine", "y"]["sd_inside"] is inside
    assert_allclose(rows["medial_spine", "y"]["sd_ratio"], stretch, rtol=0.1)


def test_normalised_landmarks_do_not_depend_on_pose_and_size():
    sample = make_contours(count=5)
    fractions, width = landmark_comparison.normalise_to_plateau(sample.landmarks_mm)
    after, wide = landmark_comparison.normalise_to_plateau(
        transform_points(sample.landmarks_mm, 12.0, 1.3, (40.0, -7.0))
    )
    assert_allclose(after, fractions, atol=1e-12)
    assert_allclose(wide, 1.3 * width)
    edges = [CONTOUR_LANDMARKS.index(f"tibia_{side}_edge") for side in ("lateral", "medial")]
    assert_allclose(fractions[:, edges], np.tile([[-0.5, 0.0], [0.5, 0.0]], (5, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("grade", range(5))
def test_the_mean_patient_contour_has_the_mean_patient_joint_sizes(grade):
    # Mean contours have nearly the mean gap; their minimum gap exceeds the mean of the minimum gaps of patients.
    known = REFERENCE.grade[str(grade)]
    sizes = landmark_comparison.measure_joint_sizes(np.array(known.mean_share)[None] * known.plateau_width_mm[0])
    for at in ("0150", "0200", "0250", "0300"):
        assert_allclose(sizes[f"medial_gap_at_{at}_mm"], getattr(known, f"medial_gap_at_{at}_mm")[0], atol=0.15)
    assert_allclose(sizes["joint_line_convergence_deg"], known.joint_line_convergence_deg[0], atol=0.1)
    for side in ("medial", "lateral"):
        least = getattr(known, f"{side}_gap_least_mm")[0]
        assert least - 0.05 < sizes[f"{side}_gap_least_mm"][0] < least + 0.9


def test_knees_sampled_from_the_patient_modes_have_the_same_modes():
    known = REFERENCE.modes
    weights = np.random.default_rng(1).standard_normal((4000, len(known.vectors))) * known.sd[: len(known.vectors)]
    fractions = np.array(REFERENCE.grade["0"].mean_share).ravel() + weights @ np.array(known.vectors)
    sample = landmark_comparison.LandmarkSample(
        landmarks_mm=fractions.reshape(-1, 16, 2) * 77.0, grades=np.zeros(4000, int)
    )
    rows = landmark_comparison.compare_contours(sample, REFERENCE).modes
    assert [row["mode"] for row in rows] == list(range(1, 9))
    for row in rows[:3]:
        assert row["nearest"] == row["mode"]
        assert row["cosine"] > 0.95
        assert_allclose(row["simulated_sd"], row["patient_sd"], rtol=0.05)
    still = dataclasses.replace(sample, landmarks_mm=make_contours(count=4000).landmarks_mm)
    assert landmark_comparison.compare_contours(still, REFERENCE).modes[0]["cosine"] < 0.9


def test_every_grade_is_compared_with_its_own_reference():
    both = [make_contours(grade=grade, seed=grade) for grade in (0, 4)]
    sample = landmark_comparison.LandmarkSample(
        landmarks_mm=np.concatenate([one.landmarks_mm for one in both]), grades=np.repeat([0, 4], 600)
    )
    found = landmark_comparison.compare_contours(sample, REFERENCE)
    assert [row["outside"] for row in found.outside] == [0, 0]
    assert {row["grade"] for row in found.sizes} == {0, 4}
    swapped = landmark_comparison.compare_contours(
        dataclasses.replace(sample, grades=np.repeat([4, 0], 600)), REFERENCE
    )
    assert all(row["outside"] > 3 for row in swapped.outside)


def test_a_single_knee_or_an_unknown_grade_raises_an_error():
    with pytest.raises(pssf.InputError, match="knees with grade 0 must be 2 or more, got 1"):
        landmark_comparison.compare_contours(make_contours(count=1), REFERENCE)
    with pytest.raises(pssf.InputError, match="one or more of 0, 1, 2, 3, 4, got 7"):
        landmark_comparison.compare_contours(
            dataclasses.replace(make_contours(count=3), grades=np.full(3, 7)), REFERENCE
        )
    with pytest.raises(pssf.InputError, match="must be above 0 mm, got 0 mm"):
        landmark_comparison.normalise_to_plateau(np.zeros((1, 16, 2)))


def compute_sampled_landmarks(count, seed, protocol):
    knees = sample_knees(load_knee_distributions("population"), count, seed, side="right", jsw_definition="read")
    acquisitions = [(knee, protocol) for knee in knees]
    return landmark_comparison.compute_simulated_landmarks(
        acquisitions, load_anatomy_tables(), load_jsw_protocol(knees[0])
    )


def test_sampled_landmarks_equal_the_labels_of_the_built_knee():
    protocol = pssf.load_protocol("caudal_beam")
    sample = compute_sampled_landmarks(1, 3, protocol)
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(0,)))
    knee = pssf.sample_knee(grade=0, rng=rng, grade_table="population", side="left")
    labels = pssf.build(knee).truth(protocol).landmarks_px
    left_landmarks = landmark_comparison.convert_landmarks_to_mm(labels, "left", protocol.pixel_mm)
    assert_allclose(
        *(landmark_comparison.normalise_to_plateau(one[None])[0] for one in (left_landmarks, sample.landmarks_mm[0])),
        atol=1e-6,
    )


def test_a_sampled_knee_does_not_depend_on_the_number_of_knees():
    few, more = (compute_sampled_landmarks(count, 5, pssf.load_protocol("reference")) for count in (1, 3))
    assert_array_equal(few.landmarks_mm[0], more.landmarks_mm[0])
    assert np.abs(more.landmarks_mm[1] - more.landmarks_mm[0]).max() > 0.1


def test_the_contour_figure_is_a_reproducible_png():
    one, other = (landmark_comparison.compare_contours(make_contours(count=9), REFERENCE).figure for _ in range(2))
    assert one == other
    assert one.startswith(b"\x89PNG")


def write_manifest(folder, monkeypatch, labels, side):
    """Write a cohort manifest, and replace the labels that are loaded from its files by `labels`."""
    (folder / "manifest.csv").write_text(
        "protocol,file\n" + "".join(f"fixed_flexion,{name}\n" for name in labels) + "reference,other\n"
    )

    def load_parameters(path):
        grade, points_mm = labels[path.name]
        pixel_mm = 0.3
        medial = 1.0 if side == "right" else -1.0
        landmarks_px = {
            name: (-y / pixel_mm, x * medial / pixel_mm)
            for name, (x, y) in zip(CONTOUR_LANDMARKS, points_mm, strict=True)
        }
        truth = pssf.Truth(jsw_medial_mm=4.0, jsw_lateral_mm=4.0, grade=grade, landmarks_px=landmarks_px)
        protocol = dataclasses.replace(pssf.load_protocol("fixed_flexion"), pixel_mm=pixel_mm)
        return {"knee": pssf.Knee(side=side), "truth": truth, "protocol": protocol}

    monkeypatch.setattr("pssf.patient_comparison.contours.cohort_landmarks.load_parameters", load_parameters)


@pytest.mark.parametrize("side", ["right", "left"])
def test_landmarks_of_simulated_knees_equal_their_projected_labels(side, tmp_path, monkeypatch):
    labels = {f"k{k}.tif": (k % 2, make_contours(grade=k % 2, count=1, seed=k).landmarks_mm[0]) for k in range(6)}
    write_manifest(tmp_path, monkeypatch, labels, side)
    sample = load_cohort_landmarks(tmp_path, "fixed_flexion")
    assert_allclose(sample.landmarks_mm, [points_mm for _, points_mm in labels.values()], atol=1e-9)
    assert sample.grades.tolist() == [0, 1] * 3
    sizes = landmark_comparison.compare_contours(sample, REFERENCE).sizes
    assert {(row["grade"], row["quantity"]) for row in sizes} >= {
        (0, "medial_gap_least_mm"),
        (1, "lateral_gap_least_mm"),
    }


def test_a_folder_without_a_cohort_or_its_protocol_raises_an_error(tmp_path, monkeypatch):
    with pytest.raises(pssf.InputError, match=r"without manifest\.csv"):
        load_cohort_landmarks(tmp_path, "reference")
    write_manifest(tmp_path, monkeypatch, {"k.tif": (None, make_contours(count=1).landmarks_mm[0])}, "right")
    with pytest.raises(pssf.InputError, match="protocol must be one of fixed_flexion, reference, got 'low_dose'"):
        load_cohort_landmarks(tmp_path, "low_dose")
    with pytest.raises(pssf.InputError, match=r"grade of every radiograph must be known, got no grade for file k\.tif"):
        load_cohort_landmarks(tmp_path, "fixed_flexion")


def test_the_auc_of_the_joint_gap_is_compared_with_that_of_patients():
    samples = {grade: make_contours(grade=grade, seed=grade) for grade in (0, 2, 4)}

    def join_grades(*grades):
        points, labels = zip(*((samples[g].landmarks_mm, samples[g].grades) for g in grades), strict=True)
        return landmark_comparison.LandmarkSample(landmarks_mm=np.concatenate(points), grades=np.concatenate(labels))

    rows = {row["grade"]: row for row in landmark_comparison.compare_contours(join_grades(0, 2, 4), REFERENCE).gap_auc}
    assert set(rows) == {2, 4}
    assert [rows[4][name] for name in ("patient_auc", "patient_auc_low", "patient_auc_high")] == list(
        REFERENCE.gap_alone_auc["kl4"]
    )
    assert rows[2]["auc"] < rows[4]["auc"] > 0.9
    assert all(row["low"] < row["auc"] <= row["high"] and row["knees"] == 1200 for row in rows.values())
    assert landmark_comparison.compare_contours(join_grades(2, 4), REFERENCE).gap_auc == []


@pytest.mark.slow  # 300 knees: two minutes on two cores
def test_joint_gaps_of_sampled_knees_agree_with_patients_per_grade():
    count, knees = 60, sample_knees(load_knee_distributions("population"), 300, 0, side="right", jsw_definition="read")
    protocol = pssf.load_protocol("fixed_flexion")
    acquisitions = landmark_comparison.sample_acquisitions(
        knees, partial(pssf.sample_acquisition, protocol, side="right"), 0
    )
    sample = landmark_comparison.compute_simulated_landmarks(
        acquisitions, load_anatomy_tables(), load_jsw_protocol(knees[0]), 2
    )
    compared = landmark_comparison.compare_contours(sample, REFERENCE)
    gaps = [row for row in compared.sizes if "gap" in row["quantity"]]
    assert len(gaps) == 5 * 6
    # Tolerances: 0.25 mm for gaps, 25 % for SDs and the confidence interval of patients; plus two standard errors.
    off_mm = {
        (row["grade"], row["quantity"]): abs(row["simulated_mean"] - row["patient_mean"])
        - 2 * row["patient_sd"] * np.sqrt(1 / count + 1 / 150)
        for row in gaps
    }
    assert max(off_mm.values()) < 0.25, max(off_mm, key=off_mm.get)
    spread = {(row["grade"], row["quantity"]): abs(np.log(row["sd_ratio"])) for row in gaps}
    assert max(spread.values()) < np.log(1.25) + 2 * np.sqrt(1 / (2 * count) + 1 / 300), max(spread, key=spread.get)
    for row in compared.gap_auc:
        chance = 2 * np.sqrt(1 / (6 * count))
        assert row["patient_auc_low"] - chance < row["auc"] < row["patient_auc_high"] + chance
