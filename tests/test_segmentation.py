"""Check bone segmentation accuracy, subjects per feature, tuned parameters and the description of image processing."""

import numpy as np
import pandas as pd
import pytest
from synthetic_features import make_settings

from pssf.core.processes.execution import Execution
from pssf.radiomics.features.feature_families import TEXTURES
from pssf.radiomics.features.image_processing import describe_processing
from pssf.radiomics.features.mask_overlap import compute_mask_overlap
from pssf.study.design.study_tables import load_study_tables
from pssf.study.report.report_sections import make_segmentation_section
from pssf.study.segmentation_accuracy import evaluate_segmentation
from pssf.study.statistics.features.dimensions import count_dimensions, count_tuned_values
from pssf.study.study_data import StudyContext


def make_square_mask(top, left, side, size=40):
    mask = np.zeros((size, size), bool)
    mask[top : top + side, left : left + side] = True
    return mask


def test_a_mask_overlaps_itself_completely_and_distances_are_in_mm():
    one = make_square_mask(10, 10, 12)
    assert compute_mask_overlap(one, one, 0.5) == {"dice": 1.0, "mean_mm": 0.0, "p95_mm": 0.0, "area": 1.0}
    moved = compute_mask_overlap(make_square_mask(10, 14, 12), one, 0.5)
    assert moved["dice"] == pytest.approx(8 / 12)
    assert moved["area"] == 1.0
    assert 0 < moved["mean_mm"] < moved["p95_mm"] == pytest.approx(2.0)
    assert compute_mask_overlap(make_square_mask(10, 14, 12), one, 1.0)["mean_mm"] == pytest.approx(
        2 * moved["mean_mm"]
    )


def test_the_distance_between_concentric_squares_is_their_margin():
    inner, outer = make_square_mask(12, 12, 10), make_square_mask(10, 10, 14)
    agreed = compute_mask_overlap(inner, outer, 1.0)
    assert agreed["area"] == pytest.approx(100 / 196)
    assert agreed["dice"] == pytest.approx(200 / 296)
    assert 2.0 <= agreed["mean_mm"] <= 2.0 * np.sqrt(2)


def test_distances_ignore_empty_masks_and_image_borders():
    empty = np.zeros((40, 40), bool)
    assert compute_mask_overlap(empty, make_square_mask(1, 1, 5), 1.0)["dice"] == 0.0
    assert np.isnan(compute_mask_overlap(empty, make_square_mask(1, 1, 5), 1.0)["mean_mm"])
    assert np.isnan(compute_mask_overlap(empty, empty, 1.0)["dice"])
    half, more = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    half[:20], more[:23] = True, True
    assert compute_mask_overlap(half, more, 1.0)["mean_mm"] == pytest.approx(3.0)


def render_bone(bone):
    return np.where(bone, 2000, 8000).astype(np.uint16)


def make_context(masks, out):
    return StudyContext(
        lambda file: render_bone(make_square_mask(30, 20, 60, 128)), (), make_settings(region_px=128), out,
        Execution(workers=1), load_study_tables(), masks,
    )  # fmt: skip


def make_radiographs(count=3):
    row = {"file": "a.tif", "row_px": 64.0, "col_px": 64.0, "pixel_mm": 0.2, "sdd_mm": 1000.0, "sod_mm": 900.0}
    rows = [row | {"radiograph": f"r{k}", "grade": k % 2} for k in range(count)]
    return pd.DataFrame(rows), pd.DataFrame({"radiograph": [f"r{k}" for k in range(count)], "masks": "m.tif"})


def test_segmented_bone_is_compared_with_all_bones_in_the_region(tmp_path):
    two = {
        "femur": make_square_mask(30, 20, 30, 128) | make_square_mask(30, 50, 30, 128),
        "tibia": make_square_mask(60, 20, 60, 128),
    }
    two["tibia"][90:] = False
    table = evaluate_segmentation(*make_radiographs(), make_context(lambda file: two, tmp_path))
    assert list(table["grade"]) == ["0", "1", "all"]
    assert list(table["radiographs"]) == [2, 1, 3]
    assert (table["dice"] > 0.95).all()
    assert (table["mean_mm"] < 0.5).all()
    less = evaluate_segmentation(*make_radiographs(), make_context(lambda file: {"femur": two["femur"]}, tmp_path))
    assert (less["dice"] < 0.8).all()
    (section,) = make_segmentation_section(table)
    assert len(section.table) == 3


def test_without_masks_there_is_no_segmentation_accuracy(tmp_path):
    repeated, retest = make_radiographs()
    for masks, manifest in ((None, retest), (lambda file: {}, None), (lambda file: {}, retest.drop(columns="masks"))):
        table = evaluate_segmentation(repeated, manifest, make_context(masks, tmp_path))
        assert table.empty
        assert make_segmentation_section(table) == []


def test_the_lowest_ratio_of_subjects_to_features_is_reported():
    usable = pd.DataFrame({"subject": range(30), "grade": [0, 1, 2] * 10})
    subjects = pd.DataFrame({"repeat": [0] * 30 + [1] * 30, "subject": [*range(30)] * 2, "part": "training"})
    # The test part of split 0 has two subjects of each grade.
    subjects.loc[:5, "part"] = "test"
    arm = {"task": "0 vs 2", "trained_on": "reference", "selection": "l1"}
    kept = [arm | {"model": "lr", "repeat": repeat, "feature": f} for repeat, fs in ((0, "ab"), (1, "abc")) for f in fs]
    offered = [arm | {"repeat": repeat, "feature": f} for repeat in (0, 1) for f in "abcde"[: 4 + repeat]]
    (row,) = count_dimensions(pd.DataFrame(kept), pd.DataFrame(offered), subjects, usable, 9).to_dict("records")
    counts = {"subjects": 20, "features_measured": 9, "features_offered": 5, "features_selected": 3}
    assert row == {**arm, **counts, "subjects_per_feature": pytest.approx(20 / 3)}

    (row,) = count_dimensions(pd.DataFrame(kept), pd.DataFrame(offered).iloc[:0], subjects, usable, 9).to_dict(
        "records"
    )
    assert pd.isna(row["features_offered"])


def test_tuned_values_are_counted_by_split_in_order_of_frequency():
    arm = {"task": "0 vs 2", "trained_on": "reference", "model": "lr", "selection": "l1", "parameter": "C"}
    tuned = pd.DataFrame([arm | {"repeat": repeat, "value": value} for repeat, value in enumerate((1.0, 0.1, 1.0))])
    assert count_tuned_values(tuned)[["value", "splits"]].to_numpy().tolist() == [[1.0, 2], [0.1, 1]]
    assert count_tuned_values(pd.DataFrame()).empty


def test_image_processing_is_described_only_for_measured_families():
    everything = describe_processing(512, 64, ("firstorder", "shape2D", *TEXTURES))
    assert set(everything["texture"]) == set(TEXTURES)
    assert "64 bins of equal width" in everything["discretisation"]
    assert "512 x 512" in everything["segmentation"]
    plain = describe_processing(512, 64, ("firstorder",))
    assert not {"texture", "discretisation", "bone"} & set(plain)
