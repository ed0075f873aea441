"""Check which items of reporting guidelines are answered by the files of a study."""

import csv
import json
import shutil

import pytest

from pssf.data.analysis.reporting_table import load_reporting_guidelines
from pssf.io.file_conditions import find_unmet_condition
from pssf.study.report.reporting_checklist import STATUSES, fill_checklist


def write_table(path, rows):
    with open(path, "w", newline="") as handle:
        writer = csv.DictWriter(handle, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def change_rows(path, change):
    """Apply a function to each row of a CSV table."""
    with open(path, newline="") as handle:
        rows = list(csv.DictReader(handle))
    write_table(path, [row | change(row) for row in rows])


@pytest.fixture(scope="module")
def whole(film_study, tmp_path_factory):
    """Copy a study and add files that only larger studies contain, so that all items are answered."""
    folder = tmp_path_factory.mktemp("whole_study") / "out"
    shutil.copytree(film_study.report.parent, folder)
    for name in ("cohort", "repeats"):
        (folder / name).mkdir(exist_ok=True)
    known = {"file": "images/a.tif", "sha256": "a", "grade": 0, "tube_kv": 70, "pixel_mm": 0.15, "mas": 2}
    write_table(folder / "cohort/manifest.csv", [known | {"stature_mm": 1700}, known | {"sha256": "b"}])
    write_table(folder / "repeats/manifest.csv", [{"masks": "masks/a.tif"}])
    cohort = {"protocols": [{"name": "reference"}], "knees": [{"index": 0}], "versions": {"pssf": "0"}}
    (folder / "cohort/cohort.json").write_text(json.dumps(cohort))
    write_table(folder / "segmentation.csv", [{"grade": "all", "dice": 0.7, "mean_mm": 3.0}])
    write_table(folder / "confounders.csv", [{"confounder": "age_years", "value": 0.1}])
    write_table(folder / "subgroups.csv", [{"subgroup": "female", "auc": 0.9}])
    write_table(folder / "morphology.csv", [{"parameter": "stature_mm", "mean": 1700}])
    write_table(
        folder / "dimensions.csv",
        [{"features_measured": 9, "features_offered": 5, "features_selected": 5, "subjects_per_feature": 12.5}] * 2,
    )
    write_table(folder / "calibration.csv", [{"model": "lr", "slope": 1.1}, {"model": "rf", "slope": 0.9}])
    write_table(folder / "reliability.csv", [{"feature": "a", "ICC(2,1)": 0.9, "variance_fraction_knee": 0.8}])
    change_rows(folder / "scores.csv", lambda row: {"auc_low": 0.5, "auc_high": 0.9})
    write_table(folder / "differences.csv", [{"difference": 0.1, "low": 0.1, "p_holm": 0.5}])
    with open(folder / "scores.csv", newline="") as handle:
        rows = list(csv.DictReader(handle))
    others = [{"scenario": "cross_stable"}, {"scenario": "cross"}, {"model": "jsw"}]
    others.append({"model": "chance", "selection": "none", "auc_low": 0.5, "auc_high": 0.5})
    write_table(folder / "scores.csv", [*rows, *({**rows[0], **other} for other in others)])
    return folder


@pytest.fixture
def folder(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "out")
    return tmp_path / "out"


def find_status(folder, guideline, item):
    (one,) = [
        one
        for one in fill_checklist(folder, load_reporting_guidelines())["items"]
        if (one["guideline"], one["id"]) == (guideline, item)
    ]
    return one["status"], one["evidence"]


def test_a_complete_study_answers_every_item_that_files_can_answer(whole):
    answered = fill_checklist(whole, load_reporting_guidelines())
    expected = {(name, item.id): item.status for name, one in load_reporting_guidelines().items() for item in one.items}
    given = {(item["guideline"], item["id"]): item["status"] for item in answered["items"]}
    assert given == expected
    assert {item["status"] for item in answered["items"]} <= set(STATUSES)
    assert sum(answered["summary"]["METRICS"].values()) == 30
    weights = {item.id: item.weight for item in load_reporting_guidelines()["METRICS"].items if item.status != "none"}
    ours = [item for item in answered["items"] if item["guideline"] == "METRICS"]
    earned = sum(weights[item["id"]] for item in ours if item["status"] == "yes")
    assert answered["metrics_score_percent"] == round(100 * earned / sum(weights.values()), 1)


def test_an_empty_folder_answers_no_item_of_the_checklist(tmp_path):
    items = fill_checklist(tmp_path, load_reporting_guidelines())["items"]
    assert not [item for item in items if item["status"] == "yes"]
    (no,) = [item for item in items if (item["guideline"], item["id"]) == ("CLEAR", "40")]
    assert no == {
        "guideline": "CLEAR", "id": "40", "item": "Uncertainty", "status": "no",
        "evidence": f"{WIDE}: not met in this run",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("guideline", "items"),
    [("METRICS", "1 28 29 30"), ("IBSI", "72 75 76"), ("CLEAR", "7 53 54 55 56 57 58"), ("TRIPOD+AI", "18e-f")],
)
def test_items_that_only_authors_can_answer_have_the_status_human(whole, guideline, items):
    for item in items.split():
        assert find_status(whole, guideline, item)[0] == "human"


def change_all_but_first(file, rest, **first):
    """Return a function that sets `first` in the first row of a table and `rest` in all others."""

    def cut(folder):
        with open(folder / file, newline="") as handle:
            rows = list(csv.DictReader(handle))
        assert len(rows) > 1
        write_table(folder / file, [rows[0] | first, *(row | rest for row in rows[1:])])

    return cut


def set_rho_to_one(folder):
    content = json.loads((folder / "study.json").read_text())
    content["settings"]["rho"] = 1.0
    (folder / "study.json").write_text(json.dumps(content))


def set_values(file, **values):
    return lambda folder: change_rows(folder / file, lambda row: values)


def remove_key(file, *keys):
    def cut(folder):
        content = json.loads((folder / file).read_text())
        inner = content
        for key in keys[:-1]:
            inner = inner[key]
        del inner[keys[-1]]
        (folder / file).write_text(json.dumps(content))

    return cut


def remove_words(words):
    def cut(folder):
        page = folder / "report.html"
        assert words in " ".join(page.read_text().split())
        page.write_text(" ".join(page.read_text().split()).replace(words, ""))

    return cut


def rename_models(folder):
    for path in (folder / "models").iterdir():
        path.rename(path.with_suffix(".txt"))


FEWER, RHO = "dimensions.csv features_offered < features_measured", "study.json settings.rho < 1"
WIDE = "scores.csv auc_low < auc_high but for selection = none"
ONE_INTERVAL = change_all_but_first("scores.csv", {"auc_low": "", "auc_high": ""})
NO_WIDTH = change_all_but_first("scores.csv", {"auc_low": 0.5, "auc_high": 0.5})
ONE_SLOPE = change_all_but_first("calibration.csv", {"slope": ""}, slope=-3)
CONTENT = [
    ("METRICS", "15", FEWER, set_values("dimensions.csv", features_offered=9)),
    ("METRICS", "15", FEWER, change_all_but_first("dimensions.csv", {"features_offered": ""})),
    ("METRICS", "15", RHO, set_rho_to_one),
    ("IBSI", "74", FEWER, set_values("dimensions.csv", features_offered=9)),
    ("IBSI", "74", RHO, set_rho_to_one),
    ("CLEAR", "33", FEWER, set_values("dimensions.csv", features_offered=9)),
    ("CLEAR", "33", RHO, set_rho_to_one),
    ("METRICS", "21", WIDE, ONE_INTERVAL),
    ("METRICS", "21", WIDE, NO_WIDTH),
    ("CLEAR", "40", WIDE, ONE_INTERVAL),
    ("CLEAR", "40", WIDE, NO_WIDTH),
    ("TRIPOD+AI", "23a", WIDE, ONE_INTERVAL),
    ("TRIPOD+AI", "23a", WIDE, NO_WIDTH),
    ("CLAIM", "performance", WIDE, NO_WIDTH),
    ("METRICS", "22", "calibration.csv slope every", ONE_SLOPE),
    ("TRIPOD+AI", "12e", "calibration.csv slope every", ONE_SLOPE),
    ("METRICS", "9", "segmentation.csv dice", set_values("segmentation.csv", dice="")),
    ("METRICS", "9", "segmentation.csv mean_mm", set_values("segmentation.csv", mean_mm="nan")),
    ("METRICS", "14", "scores.csv scenario = cross_stable", set_values("scores.csv", scenario="within")),
    (
        "METRICS",
        "16",
        "dimensions.csv subjects_per_feature >= 10",
        set_values("dimensions.csv", subjects_per_feature=9.9),
    ),
    ("METRICS", "18", "subjects.csv part = test", set_values("subjects.csv", part="training")),
    ("METRICS", "18", "subjects.csv repeat+subject unique", set_values("subjects.csv", subject="1")),
    ("METRICS", "19", "confounders.csv value", set_values("confounders.csv", value="")),
    ("METRICS", "20", "scores.csv balanced_accuracy", set_values("scores.csv", balanced_accuracy="")),
    ("METRICS", "20", "confusion.csv count", set_values("confusion.csv", count="")),
    ("METRICS", "21", WIDE, set_values("scores.csv", auc_low="")),
    ("METRICS", "22", "calibration.csv slope every", set_values("calibration.csv", slope="")),
    (
        "METRICS",
        "22",
        "calibration_curve.csv observed_fraction",
        set_values("calibration_curve.csv", observed_fraction=""),
    ),
    ("METRICS", "24", "scores.csv model = jsw", set_values("scores.csv", model="lr")),
    ("METRICS", "25", "scores.csv model = chance", set_values("scores.csv", model="lr")),
    ("IBSI", "56", "study.json processing.discretisation", remove_key("study.json", "processing", "discretisation")),
    ("IBSI", "62-71", "study.json processing.texture", remove_key("study.json", "processing", "texture")),
    ("TRIPOD+AI", "12b", "report.html standardisation and selection", remove_words("standardisation and selection")),
    ("TRIPOD+AI", "12c", "tuning.csv value", set_values("tuning.csv", value="")),
    ("TRIPOD+AI", "12c", "models/*.skops", rename_models),
    ("TRIPOD+AI", "12e", "calibration.csv slope every", set_values("calibration.csv", slope="")),
    (
        "TRIPOD+AI",
        "13",
        "report.html All grades have the same weight in model fitting",
        remove_words("All grades have the same weight in model fitting"),
    ),
    ("CLEAR", "14", "cohort/manifest.csv sha256 unique", set_values("cohort/manifest.csv", sha256="a")),
    ("CLEAR", "35", "tuning.csv value", set_values("tuning.csv", value="")),
    ("CLEAR", "36", "confounders.csv value", set_values("confounders.csv", value="nan")),
    (
        "CLEAR",
        "37",
        "report.html No model is selected by its test result",
        remove_words("No model is selected by its test result"),
    ),
    ("CLEAR", "34", "models/*.skops", rename_models),
]


@pytest.mark.parametrize(
    ("guideline", "item", "condition", "damage"), CONTENT, ids=[" ".join(one[:3]) for one in CONTENT]
)
def test_an_item_without_the_required_content_is_not_answered(folder, guideline, item, condition, damage):
    assert find_status(folder, guideline, item)[0] == "yes"
    damage(folder)
    assert find_status(folder, guideline, item) == ("no", f"{condition}: not met in this run")


def test_a_table_without_rows_meets_no_condition(tmp_path):
    (tmp_path / "scores.csv").write_text("model,auc\n")
    assert find_unmet_condition(tmp_path, "scores.csv auc") == "scores.csv auc"
    (tmp_path / "scores.csv").write_text("model,auc\nlr,0.5\n")
    assert find_unmet_condition(tmp_path, "scores.csv auc") == ""
    assert find_unmet_condition(tmp_path, "scores.csv auc; scores.csv model = rf") == "scores.csv model = rf"
    assert find_unmet_condition(tmp_path, "scores.csv auc >= 0.6") == "scores.csv auc >= 0.6"


@pytest.mark.parametrize(
    ("condition", "rows", "is_met"),
    [
        ("a every", "1,2\n3,4", True),
        ("a every", "1,2\n,4", False),
        ("a >= 1", "1,2\n,4", False),
        ("a < b", "1,2\n3,4", True),
        ("a < b", "1,2\n4,4", False),
        ("a < b", "1,2\n3,", False),
        ("a < 4", "1,2\n3,4", True),
        ("a < b but for b = 4", "1,2\n5,4", True),
        ("a < b but for b = 4", "5,4", False),
        ("a unlike", "1,2", False),
    ],
)
def test_a_checklist_condition_applies_to_all_rows_that_are_not_exempt(tmp_path, condition, rows, is_met):
    (tmp_path / "some.csv").write_text(f"a,b\n{rows}\n")
    assert (find_unmet_condition(tmp_path, f"some.csv {condition}") == "") == is_met


def test_an_unreadable_file_meets_no_condition(tmp_path):
    (tmp_path / "study.json").write_text("{")
    assert find_unmet_condition(tmp_path, "study.json settings.bins") == "study.json settings.bins"
    (tmp_path / "study.json").write_text('{"settings": {"bins": 0, "none": {}}}')
    assert find_unmet_condition(tmp_path, "study.json settings.bins") == ""
    assert find_unmet_condition(tmp_path, "study.json settings.none") == "study.json settings.none"
