"""Check the label export: COCO, landmark points and readings in the format of the Osteoarthritis Initiative."""

import csv
import json

import numpy as np
import pytest
from conftest import write_small_protocol

import pssf
from pssf import InputError
from pssf.cohort import (
    make_cohort,
    plan_cohort,
    verify_cohort,
    write_labels,
)
from pssf.io.label_formats import read_pts

# Column names of knee readings in the Osteoarthritis Initiative, without the prefix that identifies the visit.
OAI_GRADE_COLUMNS = [
    "XRKL",
    *("XROSFM", "XROSFL", "XROSTM", "XROSTL", "XRJSM", "XRJSL", "XRSCFM", "XRSCFL", "XRSCTM", "XRSCTL"),
    *("XRCYFM", "XRCYFL", "XRCYTM", "XRCYTL", "XRATTM", "XRATTL"),
]
OAI_JSW_COLUMNS = [
    *("HKANGLE", "MCMJSW"),
    *("JSW150", "JSW175", "JSW200", "JSW225", "JSW250", "JSW275", "JSW300"),
    *("LJSW700", "LJSW725", "LJSW750", "LJSW775", "LJSW800", "LJSW825", "LJSW850", "LJSW875", "LJSW900"),
]
OWN_COLUMNS = [
    *(
        "jsw_medial_mm",
        "jsw_lateral_mm",
        "nominal_jsw_medial_mm",
        "nominal_jsw_lateral_mm",
        "attrition_medial_mm",
        "attrition_lateral_mm",
    ),
    *("femorotibial_deg", "tibial_slope_deg", "insall_salvati", "inter_margin_mm"),
]


@pytest.fixture(scope="module")
def labelled_cohort(small_protocols, tmp_path_factory):
    folder = tmp_path_factory.mktemp("labelled_cohort") / "cohort"
    overrides = {"knees": [1, 1], "protocols": small_protocols[:1], "grade_table": "population"}
    make_cohort(plan_cohort("quick", seed=5, overrides=overrides), folder, workers=1)
    return folder


def test_exported_labels_equal_the_labels_in_the_radiographs(labelled_cohort, tmp_path):
    folder = labelled_cohort
    paths = write_labels(folder, tmp_path / "labels")
    assert all(path.exists() for path in paths)
    rows = {row["radiograph"]: row for row in csv.DictReader((tmp_path / "labels" / "readings.csv").open())}
    manifest = list(csv.DictReader((folder / "manifest.csv").open()))
    assert len(rows) == len(manifest)
    coco = json.loads((tmp_path / "labels" / "coco.json").read_text())
    files = {image["id"]: image["file_name"] for image in coco["images"]}
    names = coco["categories"][0]["keypoints"]
    assert set(map(tuple, coco["categories"][0]["skeleton"])) >= {(1, 2), (10, 11)}
    assert (9, 10) not in set(map(tuple, coco["categories"][0]["skeleton"]))
    for made_row, annotation in zip(manifest, coco["annotations"], strict=True):
        truth = pssf.load(folder / made_row["file"]).truth
        points = read_pts(tmp_path / "labels" / "landmarks" / f"{made_row['radiograph']}.pts", names)
        keypoints = np.array(annotation["keypoints"]).reshape(-1, 3)
        for name, (x, y, visibility) in zip(names, keypoints, strict=True):
            assert points[name] == pytest.approx(truth.landmarks_px[name], abs=1e-4)
            assert (y, x) == pytest.approx(truth.landmarks_px[name], abs=1e-4)
            assert visibility == 2
        picture = tmp_path / "labels" / "images" / files[annotation["image_id"]]
        assert picture.parent.name == made_row["grade"]
        assert made_row["grade_table"] == "population"
        reading = rows[made_row["radiograph"]]
        assert reading["SIDE"] == {"right": "1", "left": "2"}[made_row["side"]]
        assert float(reading["attrition_medial_mm"]) == float(made_row["truth_attrition_medial_mm"])
        assert int(reading["XRATTM"]) == sum(truth.attrition_mm["medial"] >= cut for cut in (0.25, 1.0, 2.0))
        assert float(reading["femorotibial_deg"]) == pytest.approx(175 + float(made_row["varus_deg"]), abs=1e-3)
        assert list(reading) == [
            "ID",
            "SIDE",
            "radiograph",
            "XRKL_READ",
            *OAI_GRADE_COLUMNS,
            *OAI_JSW_COLUMNS,
            *OWN_COLUMNS,
        ]
        assert float(reading["JSW225"]) == pytest.approx(truth.jsw_at_mm[0.225], abs=1e-4)
        assert float(reading["LJSW850"]) == pytest.approx(truth.jsw_at_mm[0.850], abs=1e-4)
        assert float(reading["jsw_medial_mm"]) == pytest.approx(truth.jsw_medial_mm, abs=1e-4)
        assert float(reading["jsw_lateral_mm"]) == pytest.approx(truth.jsw_lateral_mm, abs=1e-4)
        assert float(reading["MCMJSW"]) == float(made_row["jsw_medial_mm"]) == truth.jsw_medial_mm
        assert float(reading["nominal_jsw_medial_mm"]) == float(made_row["nominal_jsw_medial_mm"])
        assert annotation["attributes"]["jsw_medial_mm"] == truth.jsw_medial_mm
        assert float(reading["HKANGLE"]) == pytest.approx(180 - truth.readings["hip_knee_ankle_deg"], abs=1e-3)
        # The manifest and the radiograph file contain the same labels.
        assert float(made_row["reader_grade"]) == truth.reader_grade == float(reading["XRKL_READ"])
        assert float(made_row["truth_jsw_225_mm"]) == pytest.approx(truth.jsw_at_mm[0.225], abs=1e-4)
        assert {name: float(made_row[f"truth_{name}"]) for name in truth.readings} == truth.readings
        assert {name: made_row[f"truth_acquisition_{name}"] for name in truth.acquisition} == {
            name: str(value) for name, value in truth.acquisition.items()
        }
        for name, (row, col) in truth.landmarks_px.items():
            name = name.removesuffix("_joint_line")
            assert float(made_row[f"truth_{name}_row_px"]) == pytest.approx(row, abs=1e-4)
            assert float(made_row[f"truth_{name}_col_px"]) == pytest.approx(col, abs=1e-4)


def test_inter_margin_label_equals_the_distance_on_the_built_knee(labelled_cohort, tmp_path):
    write_labels(labelled_cohort, tmp_path)
    apart_mm = []
    for reading in csv.DictReader((tmp_path / "readings.csv").open()):
        radiograph = pssf.load(labelled_cohort / "images" / f"{reading['radiograph']}.tif")
        built = pssf.build(radiograph.knee, radiograph.protocol)
        apart_mm.append(built.inter_margin_mm(radiograph.protocol))
        assert float(reading["inter_margin_mm"]) == pytest.approx(apart_mm[-1], abs=1e-4)
    assert len({round(value, 3) for value in apart_mm}) == len(apart_mm)


def test_a_lateral_view_raises_an_error_before_labels_are_written(small_protocols, tmp_path):
    overrides = {"knees": [1], "protocols": [small_protocols[0], write_small_protocol(tmp_path, "lateral")]}
    make_cohort(plan_cohort("quick", seed=5, overrides=overrides), tmp_path / "cohort", workers=1)
    with pytest.raises(InputError, match=r"projection must be AP or PA .* got 'ML'"):
        write_labels(tmp_path / "cohort", tmp_path / "labels")
    assert not (tmp_path / "labels").exists()


def test_labels_cannot_be_written_into_the_folder_of_the_cohort(labelled_cohort, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(labelled_cohort)
    for folder in (labelled_cohort, tmp_path / "link"):
        with pytest.raises(InputError, match="out must differ from the cohort folder"):
            write_labels(labelled_cohort, folder)
    assert verify_cohort(labelled_cohort).faults == ()


def test_labels_of_a_folder_without_a_cohort_raise_an_error(tmp_path):
    with pytest.raises(InputError, match=r"a completed cohort with manifest\.csv"):
        write_labels(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "torn.pts").write_text("version: 1\n{\n1 2\n3\n}")
    with pytest.raises(InputError, match=r"torn\.pts: number of landmarks must be 2"):
        read_pts(tmp_path / "torn.pts", ["a", "b"])
