"""What a manifest from elsewhere may not say, and what is said of it."""

import numpy as np
import pandas as pd
import pytest

from pssf.core.checks import InputError
from pssf.study.statistics.provenance import require_one_of_each, warnings_of


def manifest(subjects: int = 90, seed: int = 0) -> pd.DataFrame:
    """A knee a subject, each under two protocols; grades in no order."""
    grade = np.random.default_rng(seed).permutation(np.arange(subjects) % 3)
    rows = pd.DataFrame({"subject": range(subjects), "knee": range(subjects), "side": "right", "grade": grade})
    both = pd.concat([rows.assign(protocol=name) for name in ("reference", "other")], ignore_index=True)
    return both.assign(sha256=[f"{k:064x}" for k in range(len(both))], radiograph=range(len(both)))


def test_a_manifest_without_a_fault_passes_without_a_word():
    require_one_of_each(manifest())
    assert sum(len(warnings_of(manifest(seed=seed))) for seed in range(100)) <= 1  # 0.1 % each


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("sha256", f"{5:064x}", "file with sha256 000000000000... has subject = 3 and 5"),
        ("knee", 5, "knee 5 has subject = 3 and 5"),
    ],
)
def test_one_file_or_knee_under_two_subjects_is_refused(column, value, message):
    table = manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=message):
        require_one_of_each(table)


@pytest.mark.parametrize(("column", "value"), [("grade", 4), ("side", "left")])
def test_one_knee_of_two_grades_or_sides_is_refused(column, value):
    table = manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=rf"knee 3 has {column} = {value} and .*allowed: one {column}"):
        require_one_of_each(table)


def test_one_file_under_two_knees_of_a_subject_is_refused():
    table = manifest()
    table.loc[[3, 93], "subject"] = 5
    table.loc[3, "sha256"] = table.loc[5, "sha256"]
    with pytest.raises(InputError, match="has knee = 3 and 5"):
        require_one_of_each(table)


def test_grades_that_go_with_the_protocol_are_told_with_their_size():
    table = manifest()
    table = table[(table["grade"] != 2) | (table["protocol"] == "other") | (table["subject"] % 5 == 0)]
    (told,) = warnings_of(table)
    assert "Cramér's V 0.2" in told or "Cramér's V 0.3" in told
    assert "grade 2 is" in told
    assert "under reference" in told
    alone = manifest().query("(grade == 2) == (protocol == 'other')")
    assert "Cramér's V 1.00" in warnings_of(alone)[0]


def test_subjects_numbered_by_grade_are_told():
    table = manifest().sort_values("grade")
    ordered = table.assign(subject=np.repeat(range(90), 2))
    (told,) = warnings_of(ordered.assign(knee=ordered["subject"]))
    assert "rho +0.9" in told or "rho +1.0" in told
