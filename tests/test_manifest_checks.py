"""Check that `study.run` and `study.measure` reject invalid manifests with the same errors as the command line."""

import dataclasses

import block_knee_cohort
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pssf import study
from pssf.core.checks import InputError
from pssf.study import FilmSet
from pssf.study.design.manifest_checks import require_manifest
from pssf.study.design.patient_sets import Film

NAN = float("nan")
FAULTS = [
    ("subject", NAN, "subject must be text or a number, got nan"),
    ("subject", None, "subject must be text or a number, got None"),
    ("subject", "", "subject must be text or a number, got ''"),
    ("subject", 7, "subject must be text in all rows or numbers in all rows, got both"),
    ("knee", NAN, "knee must be text or a number, got nan"),
    ("protocol", NAN, "protocol must be text or a number, got nan"),
    ("grade", NAN, "grade must be one of 0, 1, 2, 3, 4, got nan"),
    ("grade", 1.5, "grade must be one of 0, 1, 2, 3, 4, got 1.5"),
    ("grade", "KL0", "grade must be one of 0, 1, 2, 3, 4, got 'KL0'"),
    ("grade", True, "grade must be one of 0, 1, 2, 3, 4, got True"),
    ("grade", 7, "grade must be one of 0, 1, 2, 3, 4, got 7"),
    ("side", "up", "side must be one of right, left, got 'up'"),
    ("side", NAN, "side must be one of right, left, got nan"),
    ("pixel_mm", "0.15", "pixel_mm must be between 0.001 and 50 mm, got '0.15' mm"),
    ("pixel_mm", NAN, "pixel_mm must be between 0.001 and 50 mm, got nan mm"),
    ("pixel_mm", -0.15, "pixel_mm must be between 0.001 and 50 mm, got -0.15 mm"),
    ("sdd_mm", 0.0, "mm, got 0.0 mm"),
    ("sod_mm", "far", "mm, got 'far' mm"),
    ("truth_medial_row_px", "12", "truth_medial_row_px must be a number"),
    ("file", NAN, "file must be text or a number, got nan"),
]


def make_manifest_with(column: str, value: object) -> pd.DataFrame:
    table = block_knee_cohort.select_text_subjects().reset_index(drop=True)
    cells = table[column].astype(object)
    cells[3] = value
    return table.assign(**{column: cells})


@pytest.mark.parametrize(("column", "value", "why"), FAULTS)
@pytest.mark.parametrize("entry", [study.run, study.measure])
def test_run_and_measure_reject_an_invalid_value(entry, column, value, why, tmp_path):
    with pytest.raises(InputError) as raised:
        entry(
            make_manifest_with(column, value),
            block_knee_cohort.make_cohort().load,
            [block_knee_cohort.TEMPLATE],
            block_knee_cohort.LIGHT,
            tmp_path,
        )
    assert why in str(raised.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("column", ["file", "sha256"])
@pytest.mark.parametrize("entry", [study.run, study.measure])
def test_run_and_measure_reject_a_file_in_two_rows(entry, column, tmp_path):
    table = block_knee_cohort.select_text_subjects().reset_index(drop=True)
    both = pd.concat([table, table.head(1).assign(radiograph="again")], ignore_index=True)
    other = {"file": "sha256", "sha256": "file"}[column]
    both.loc[len(table), other] = "another"
    with pytest.raises(
        InputError, match=f"{table['radiograph'][0]} and again must have different files, got the same {column}"
    ):
        entry(
            both, block_knee_cohort.make_cohort().load, [block_knee_cohort.TEMPLATE], block_knee_cohort.LIGHT, tmp_path
        )


@pytest.mark.parametrize("entry", [study.run, study.measure])
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda table: table.to_dict("records"), "must be a pandas DataFrame, got list"),
        (lambda table: table.head(0), "one row per radiograph, got no rows"),
        (
            lambda table: pd.concat([table, table[["grade"]]], axis=1),
            "must contain each column once, got 'grade' twice",
        ),
    ],
)
def test_run_and_measure_reject_an_invalid_table_of_radiographs(entry, change, why, tmp_path):
    with pytest.raises(InputError, match=why):
        entry(
            change(block_knee_cohort.select_text_subjects()),
            block_knee_cohort.make_cohort().load,
            [block_knee_cohort.TEMPLATE],
            block_knee_cohort.LIGHT,
            tmp_path,
        )


def test_manifests_of_repeats_are_checked_like_the_main_manifest(tmp_path):
    table = block_knee_cohort.select_text_subjects()
    repeats = table.head(2).assign(
        kind="noise", repeat_index=1, radiograph=["a", "b"], file=["a", "b"], sha256=["a", "b"]
    )
    repeats["side"] = ["up", "left"]
    with pytest.raises(InputError, match=r"retest manifest: radiograph a: side must be one of .*, got 'up'"):
        study.measure(
            table,
            block_knee_cohort.make_cohort().load,
            [block_knee_cohort.TEMPLATE],
            block_knee_cohort.LIGHT,
            tmp_path,
            retest=repeats,
        )


@given(grades=st.lists(st.sampled_from([0, 1, 2, 3, 4]), min_size=1, max_size=9), kind=st.sampled_from([int, float]))
def test_grades_stored_as_floats_are_converted_to_integers(grades, kind):
    checked = require_manifest(pd.DataFrame({"grade": np.array(grades, kind)}))
    assert checked["grade"].tolist() == grades
    assert checked["grade"].dtype == np.int64


def test_a_film_set_contains_only_films_and_each_film_once():
    film = Film(file="a.png", grade=0, subject="1", side=None, pixel_mm=None, sha256="0")
    given = {"load": print, "load_cohort": print, "protocol": "reference"}
    with pytest.raises(InputError, match=r"each file once, got 'a\.png' twice"):
        FilmSet(films=(film, dataclasses.replace(film, grade=None)), **given)
    with pytest.raises(InputError, match="films must contain Film objects"):
        FilmSet(films=("a.png",), **given)
