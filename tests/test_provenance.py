"""What a manifest from elsewhere may not say, and what is said of it."""

from itertools import pairwise, permutations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, norm

from pssf.core.checks import InputError
from pssf.study.statistics.analyses.leakage_checks import (
    _assess_neighbours,
    find_leakage_notes,
    find_leakage_warnings,
    require_consistent_identifiers,
)


def manifest(subjects: int = 90, seed: int = 0) -> pd.DataFrame:
    """A knee a subject, each under two protocols; grades in no order."""
    grade = np.random.default_rng(seed).permutation(np.arange(subjects) % 3)
    rows = pd.DataFrame({"subject": range(subjects), "knee": range(subjects), "side": "right", "grade": grade})
    both = pd.concat([rows.assign(protocol=name) for name in ("reference", "other")], ignore_index=True)
    return both.assign(sha256=[f"{k:064x}" for k in range(len(both))], radiograph=range(len(both)))


def test_a_manifest_without_a_fault_passes_without_a_word():
    require_consistent_identifiers(manifest())
    told = [find_leakage_warnings(manifest(seed=seed)) for seed in range(200)]
    assert not any("protocols" in one for lines in told for one in lines)  # all are under both
    # Of the order one in twenty is warned of by chance.
    assert sum(map(len, told)) <= binom.isf(1e-3, 200, 0.05)
    assert not find_leakage_notes(manifest())


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("sha256", f"{5:064x}", "file with sha256 000000000000... must have one subject, got 3 and 5"),
        ("knee", 5, "knee 5 must have one subject, got 3 and 5"),
    ],
)
def test_one_file_or_knee_under_two_subjects_is_refused(column, value, message):
    table = manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=message):
        require_consistent_identifiers(table)


@pytest.mark.parametrize(("column", "value"), [("grade", 4), ("side", "left")])
def test_one_knee_of_two_grades_or_sides_is_refused(column, value):
    table = manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=rf"knee 3 must have one {column}, got {value} and "):
        require_consistent_identifiers(table)


def test_one_file_under_two_knees_of_a_subject_is_refused():
    table = manifest()
    table.loc[[3, 93], "subject"] = 5
    table.loc[3, "sha256"] = table.loc[5, "sha256"]
    with pytest.raises(InputError, match="must have one knee, got 3 and 5"):
        require_consistent_identifiers(table)


def test_grades_that_go_with_the_protocol_are_told_with_their_size():
    table = manifest()
    table = table[(table["grade"] != 2) | (table["protocol"] == "other") | (table["subject"] % 5 == 0)]
    (told,) = find_leakage_warnings(table)
    assert "Cramér's V 0.2" in told or "Cramér's V 0.3" in told
    assert "grade 2 is" in told
    assert "under reference" in told
    alone = manifest().query("(grade == 2) == (protocol == 'other')")
    assert "Cramér's V 0.99" in find_leakage_warnings(alone)[0]  # as Bergsma's of 90 people has it where it is whole


def sites(counts: list[list[int]], seed: int = 0) -> pd.DataFrame:
    """One radiograph a subject under one of the protocols; counts (protocols, grades), numbered at random."""
    cells = [(site, grade) for site, row in enumerate(counts) for grade, count in enumerate(row) for _ in range(count)]
    number = np.random.default_rng(seed).permutation(len(cells))
    table = pd.DataFrame(cells, columns=["protocol", "grade"]).assign(subject=number, knee=number, side="right")
    return table.assign(protocol="site " + table["protocol"].astype(str))


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        # sqrt((phi^2 - 1/(n-1)) / (1 - 1/(n-1))), phi^2 = (difference of shares)^2: Bergsma 2013, eq. 3, two by two.
        ([[10, 2], [2, 10]], np.sqrt((4 / 9 - 1 / 23) / (1 - 1 / 23))),
        ([[14, 4], [4, 14]], np.sqrt(((10 / 18) ** 2 - 1 / 35) / (1 - 1 / 35))),
        ([[21, 9], [9, 21]], np.sqrt((0.4**2 - 1 / 59) / (1 - 1 / 59))),
        ([[54, 36], [36, 54]], np.sqrt((0.2**2 - 1 / 179) / (1 - 1 / 179))),
    ],
    ids=["24", "36", "60", "180"],
)
def test_a_tie_of_protocol_and_grade_is_warned_of_at_the_sizes_of_studies(counts, size):
    (told,) = [one for one in find_leakage_warnings(sites(counts)) if "protocols" in one]
    assert f"Cramér's V {size:.2f}, p 0.0" in told or f"Cramér's V {size:.2f}, p < 0.001" in told
    assert "One in twenty cohorts without such an association" in told
    assert not find_leakage_notes(sites(counts))


def test_grades_that_are_less_unlike_than_by_chance_are_told_without_a_warning():
    table = sites([[11, 9], [9, 11]])
    assert not [one for one in find_leakage_warnings(table) if "protocols" in one]
    (note,) = find_leakage_notes(table)
    assert "Cramér's V 0.00, p 0.75" in note


@pytest.mark.parametrize("pairs", [False, True], ids=["one knee", "two knees that are alike"])
@pytest.mark.parametrize("subjects", [24, 90])
def test_one_honest_cohort_in_twenty_is_warned_of_its_sites_and_no_more(subjects, pairs):
    found = 0
    for seed in range(200):
        rng = np.random.default_rng([7, seed])
        people = {"subject": range(subjects), "grade": rng.integers(3, size=subjects)}
        table = pd.DataFrame(people).assign(protocol=rng.choice(["one", "other"], subjects))
        both = pd.concat([table, table], ignore_index=True) if pairs else table
        found += any("protocols" in one for one in find_leakage_warnings(both))
    assert found <= binom.isf(1e-3, 200, 0.05)


def numbered(grades, name=int) -> pd.DataFrame:
    """A knee a subject, who are numbered in the order of these grades."""
    return pd.DataFrame({"subject": [name(k) for k in range(len(grades))], "grade": grades, "protocol": "reference"})


@pytest.mark.parametrize("name", [int, "P{}".format], ids=["numbers", "texts"])
@pytest.mark.parametrize(
    ("grades", "same"),
    [
        (np.repeat([1, 4, 2, 0, 3], 12), 55 / 59),
        (np.repeat([1, 0, 2], 5), 12 / 14),
        (np.tile([0, 1, 2], 12), 0),
        (np.tile([1, 0], 12), 0),
    ],
    ids=["blocks", "short blocks", "in turn", "even and odd"],
)
def test_subjects_numbered_by_grade_in_any_order_are_told(grades, same, name):
    (told,) = find_leakage_warnings(numbered(grades, name))
    assert f"{100 * same:.0f} % have the same grade as the subject before" in told


def test_neighbours_of_one_grade_have_the_mean_and_variance_of_all_orders():
    grades = [0, 0, 0, 1, 1, 2]
    pairs = [sum(a == b for a, b in pairwise(order)) for order in set(permutations(grades))]
    share, chance, p = _assess_neighbours(np.array(grades))
    assert (share, chance) == pytest.approx((3 / 5, np.mean(pairs) / 5))
    assert p == pytest.approx(2 * norm.sf((3 - np.mean(pairs) - 0.5) / np.std(pairs)))


def test_subjects_numbered_by_grade_are_told():
    table = manifest().sort_values("grade")
    ordered = table.assign(subject=np.repeat(range(90), 2))
    (told,) = find_leakage_warnings(ordered.assign(knee=ordered["subject"]))
    assert "rho +0.9" in told or "rho +1.0" in told
