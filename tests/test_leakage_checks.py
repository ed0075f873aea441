"""Leakage checks of a manifest: inconsistent identifiers, and associations of grade with protocol or order."""

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


def make_manifest(subjects: int = 90, seed: int = 0) -> pd.DataFrame:
    """Make one knee per subject, each under two protocols, with grades in random order."""
    grade = np.random.default_rng(seed).permutation(np.arange(subjects) % 3)
    rows = pd.DataFrame({"subject": range(subjects), "knee": range(subjects), "side": "right", "grade": grade})
    both = pd.concat([rows.assign(protocol=name) for name in ("reference", "other")], ignore_index=True)
    return both.assign(sha256=[f"{k:064x}" for k in range(len(both))], radiograph=range(len(both)))


def test_warnings_for_valid_manifests_are_as_rare_as_chance():
    require_consistent_identifiers(make_manifest())
    warnings = [find_leakage_warnings(make_manifest(seed=seed)) for seed in range(200)]
    # All knees are imaged under both protocols, so protocol and grade are independent.
    assert not any("protocols" in one for lines in warnings for one in lines)
    # One in twenty manifests gives a warning about the order of subjects by chance.
    assert sum(map(len, warnings)) <= binom.isf(1e-3, 200, 0.05)
    assert not find_leakage_notes(make_manifest())


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("sha256", f"{5:064x}", "file with sha256 000000000000... must have one subject, got 3 and 5"),
        ("knee", 5, "knee 5 must have one subject, got 3 and 5"),
    ],
)
def test_a_file_or_knee_with_two_subjects_raises_an_error(column, value, message):
    table = make_manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=message):
        require_consistent_identifiers(table)


@pytest.mark.parametrize(("column", "value"), [("grade", 4), ("side", "left")])
def test_a_knee_with_two_grades_or_sides_raises_an_error(column, value):
    table = make_manifest()
    table.loc[3, column] = value
    with pytest.raises(InputError, match=rf"knee 3 must have one {column}, got {value} and "):
        require_consistent_identifiers(table)


def test_a_file_with_two_knees_raises_an_error():
    table = make_manifest()
    table.loc[[3, 93], "subject"] = 5
    table.loc[3, "sha256"] = table.loc[5, "sha256"]
    with pytest.raises(InputError, match="must have one knee, got 3 and 5"):
        require_consistent_identifiers(table)


def test_an_association_of_grade_and_protocol_is_reported_with_cramers_v():
    table = make_manifest()
    table = table[(table["grade"] != 2) | (table["protocol"] == "other") | (table["subject"] % 5 == 0)]
    (warnings,) = find_leakage_warnings(table)
    assert "Cramér's V 0.2" in warnings or "Cramér's V 0.3" in warnings
    assert "the fraction of grade 2 is" in warnings
    assert "under protocol reference" in warnings
    alone = make_manifest().query("(grade == 2) == (protocol == 'other')")
    assert (
        "Cramér's V 0.99" in find_leakage_warnings(alone)[0]
    )  # V of a complete association of 90 subjects, with Bergsma's correction


def make_sites(counts: list[list[int]], seed: int = 0) -> pd.DataFrame:
    """Make one radiograph per subject and protocol from counts (protocols, grades), in random order."""
    cells = [(site, grade) for site, row in enumerate(counts) for grade, count in enumerate(row) for _ in range(count)]
    number = np.random.default_rng(seed).permutation(len(cells))
    table = pd.DataFrame(cells, columns=["protocol", "grade"]).assign(subject=number, knee=number, side="right")
    return table.assign(protocol="site " + table["protocol"].astype(str))


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        # V^2 = (phi^2 - 1/(n-1)) / (1 - 1/(n-1)), phi = difference of fractions (Bergsma 2013, eq. 3, 2 x 2).
        ([[10, 2], [2, 10]], np.sqrt((4 / 9 - 1 / 23) / (1 - 1 / 23))),
        ([[14, 4], [4, 14]], np.sqrt(((10 / 18) ** 2 - 1 / 35) / (1 - 1 / 35))),
        ([[21, 9], [9, 21]], np.sqrt((0.4**2 - 1 / 59) / (1 - 1 / 59))),
        ([[54, 36], [36, 54]], np.sqrt((0.2**2 - 1 / 179) / (1 - 1 / 179))),
    ],
    ids=["24", "36", "60", "180"],
)
def test_protocols_associated_with_grade_give_a_warning_with_cramers_v(counts, size):
    (warnings,) = [one for one in find_leakage_warnings(make_sites(counts)) if "protocols" in one]
    assert f"Cramér's V {size:.2f}, p 0.0" in warnings or f"Cramér's V {size:.2f}, p < 0.001" in warnings
    assert "in one of twenty cohorts without an association" in warnings
    assert not find_leakage_notes(make_sites(counts))


def test_a_chance_association_of_protocol_and_grade_gives_only_a_note():
    table = make_sites([[11, 9], [9, 11]])
    assert not [one for one in find_leakage_warnings(table) if "protocols" in one]
    (note,) = find_leakage_notes(table)
    assert "Cramér's V 0.00, p 0.75" in note


@pytest.mark.parametrize("pairs", [False, True], ids=["one knee", "two identical knees"])
@pytest.mark.parametrize("subjects", [24, pytest.param(90, marks=pytest.mark.slow)])
def test_at_most_one_in_twenty_random_cohorts_gives_a_protocol_warning(subjects, pairs):
    found = 0
    for seed in range(200):
        rng = np.random.default_rng([7, seed])
        subject_grades = {"subject": range(subjects), "grade": rng.integers(3, size=subjects)}
        table = pd.DataFrame(subject_grades).assign(protocol=rng.choice(["one", "other"], subjects))
        both = pd.concat([table, table], ignore_index=True) if pairs else table
        found += any("protocols" in one for one in find_leakage_warnings(both))
    assert found <= binom.isf(1e-3, 200, 0.05)


def make_ordered_subjects(grades, name=int) -> pd.DataFrame:
    """Make one knee per subject, numbered in the order of the given grades."""
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
def test_subjects_ordered_in_blocks_of_equal_grade_give_a_warning(grades, same, name):
    (warnings,) = find_leakage_warnings(make_ordered_subjects(grades, name))
    assert f"{100 * same:.0f} % have the same grade as the preceding subject" in warnings


def test_statistics_of_neighbouring_grades_equal_those_of_permutations():
    grades = [0, 0, 0, 1, 1, 2]
    pairs = [sum(a == b for a, b in pairwise(order)) for order in set(permutations(grades))]
    fraction, expected, p = _assess_neighbours(np.array(grades))
    assert (fraction, expected) == pytest.approx((3 / 5, np.mean(pairs) / 5))
    assert p == pytest.approx(2 * norm.sf((3 - np.mean(pairs) - 0.5) / np.std(pairs)))


def test_subjects_sorted_by_grade_give_a_warning():
    table = make_manifest().sort_values("grade")
    ordered = table.assign(subject=np.repeat(range(90), 2))
    (warnings,) = find_leakage_warnings(ordered.assign(knee=ordered["subject"]))
    assert "rho +0.9" in warnings or "rho +1.0" in warnings
