"""Check grade tables: `paper`, `population` and user tables."""

import numpy as np
import pytest
from msgspec import structs
from scipy.stats import mannwhitneyu, spearmanr

import pssf
from pssf import InputError
from pssf.cohort import plan_cohort
from pssf.data.analysis.landmark_table import load_landmark_reference
from pssf.data.knees.grade_tables import list_grade_tables, load_grade_table
from pssf.model.sampling.severity_sampling import sample_reader_grade

COUNT = 400
MARGINS = ("medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia")


@pytest.fixture(scope="module")
def population_knees():
    """Sample knees of each grade of table `population`."""
    return {
        grade: [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng((grade, k)), grade_table="population")
            for k in range(COUNT)
        ]
        for grade in range(5)
    }


def find_definite_osteophytes(knee):
    """Return the marginal osteophytes of at least 0.8 mm."""
    return [one for one in knee.osteophytes if one.site in MARGINS and one.size_mm >= 0.8]


def test_the_grade_tables_of_the_package_have_their_grades():
    assert list_grade_tables() == ["paper", "population"]
    assert load_grade_table("paper").grades == (0, 1, 2)
    assert load_grade_table("population").grades == (0, 1, 2, 3, 4)


def test_osteophytes_of_each_grade_follow_kellgren_and_lawrence(population_knees):
    assert not any(find_definite_osteophytes(knee) for knee in population_knees[0])
    assert all(one.size_mm <= 1.2 for knee in population_knees[1] for one in find_definite_osteophytes(knee))
    assert all(find_definite_osteophytes(knee) for grade in (2, 3, 4) for knee in population_knees[grade])
    assert all(knee.jsw_definition == "read" for knees in population_knees.values() for knee in knees)


def test_jsw_separates_grades_no_better_than_in_patients(population_knees):
    # Linear relation between measured minimum gap and specified joint space; bones and acquisition do not vary.
    least = {
        grade: [min(1.05 * knee.jsw_medial_mm + 0.45, 0.92 * knee.jsw_lateral_mm + 0.85) for knee in knees]
        for grade, knees in population_knees.items()
    }
    auc = {g: mannwhitneyu(least[0], least[g]).statistic / COUNT**2 for g in range(1, 5)}
    # The limits are patient confidence intervals; grade 2, near the lower limit, has a margin of one standard error.
    error = {1: 0.0, 2: np.sqrt(1 / (6 * COUNT)), 3: 0.0, 4: 0.0}
    for grade, value in auc.items():
        _, low, high = load_landmark_reference().gap_alone_auc[f"kl{grade}"]
        assert low - error[grade] <= value <= high, (grade, value)


def test_grade_parameters_overlap_and_are_correlated(population_knees):
    size = {
        g: np.array([sum(one.size_mm for one in knee.osteophytes) for knee in population_knees[g]])
        for g in population_knees
    }
    assert np.mean(np.subtract.outer(size[3], size[2]) > 0) < 0.95
    least = np.array([min(knee.jsw_medial_mm, knee.jsw_lateral_mm) for knee in population_knees[3]])
    assert np.corrcoef(size[3], least)[0, 1] < 0
    medial, lateral = (
        np.array([getattr(knee, f"jsw_{side}_mm") for knee in population_knees[0]]) for side in ("medial", "lateral")
    )
    assert np.corrcoef(medial, lateral)[0, 1] == pytest.approx(0.58, abs=4 * 0.66 / np.sqrt(COUNT))


def test_osteophytes_are_more_frequent_medially_and_on_the_tibia(population_knees):
    for grade in (2, 3, 4):
        sites = [{one.site for one in find_definite_osteophytes(knee)} for knee in population_knees[grade]]
        frequency = {margin: np.mean([margin in of_one for of_one in sites]) for margin in MARGINS}
        for bone in ("tibia", "femur"):
            assert frequency[f"medial_{bone}"] > frequency[f"lateral_{bone}"]
        # The margin is two standard errors of the difference between two frequencies.
        for side in ("medial", "lateral"):
            assert frequency[f"{side}_tibia"] > frequency[f"{side}_femur"] - 2 * np.sqrt(0.5 / COUNT)


def test_marginal_osteophytes_curve_in_both_directions(population_knees):
    curves = np.array([one.curve_deg for knee in population_knees[4] for one in find_definite_osteophytes(knee)])
    assert 0.1 < np.mean(curves < 0) < 0.9


def test_only_osteophytes_separate_grades_0_to_2_well(population_knees):
    numbers = [name for name, value in vars(population_knees[0][0]).items() if isinstance(value, float)]
    assert {"subchondral_plate", "notch_growth_mm", "effusion_mm", "varus_deg", "subluxation_mm", "bmi"} <= set(numbers)
    for name in numbers:
        healthy, doubtful, mild = (
            np.array([getattr(knee, name) for knee in population_knees[grade]]) for grade in range(3)
        )
        for grade, other in ((1, doubtful), (2, mild)):
            auc = mannwhitneyu(healthy, other).statistic / COUNT**2
            assert abs(auc - 0.5) < 0.25, (name, grade)


def test_severity_parameters_are_correlated_within_a_grade(population_knees):
    narrowed_medially = [knee for knee in population_knees[4] if knee.jsw_medial_mm < knee.jsw_lateral_mm]
    names = ("subchondral_plate", "varus_deg", "notch_growth_mm", "subluxation_mm", "effusion_mm")
    correlations = np.corrcoef([[getattr(knee, name) for knee in narrowed_medially] for name in names])
    # Each parameter correlates with severity by 0.45, so two parameters correlate by about 0.2; 10 pairs, 280 knees.
    assert correlations[np.triu_indices(5, 1)].mean() > 0.2 - 4 / np.sqrt(10 * 280)


@pytest.mark.parametrize("kappa", [0.4, 0.75, 1.0])
def test_reader_grades_differ_by_at_most_one_and_match_kappa(kappa):
    rng = np.random.default_rng(3)
    true_grades = np.repeat(np.arange(5), 2000)
    read = np.array([sample_reader_grade(int(grade), kappa, 5, rng) for grade in true_grades])
    assert abs(read - true_grades).max() <= 1
    agree = np.mean(read == true_grades)
    chance = sum(np.mean(read == grade) * np.mean(true_grades == grade) for grade in range(5))
    assert (agree - chance) / (1 - chance) == pytest.approx(kappa, abs=4 * 0.6 / np.sqrt(len(true_grades)))


def test_population_changes_only_the_tibial_slope_of_the_paper_body():
    paper, population = load_grade_table("paper"), load_grade_table("population")
    assert list(population.body) == list(paper.body)
    assert {name for name in paper.body if paper.body[name] != population.body[name]} == {"tibial_slope_deg"}


def test_bone_density_and_bmi_rise_with_grade_by_the_table():
    rest = load_grade_table("population").rest
    knees = [
        [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="population", sex="male")
            for seed in range(20)
        ]
        for grade in (0, 3)
    ]
    more = [rest.density_offset[3] - rest.density_offset[0], rest.bmi_offset[3] - rest.bmi_offset[0]]
    for name, by in zip(("bone_density", "bmi"), more, strict=True):
        differences = [getattr(high, name) - getattr(low, name) for low, high in zip(*knees, strict=True)]
        np.testing.assert_allclose(differences, by, atol=2e-4)


def test_a_user_table_inherits_the_body_of_its_base(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text("""base = "paper"
[grade.0]
jsw_medial_mm = [6.0, 6.5]
jsw_lateral_mm = [6.0, 6.5]
osteophyte_count = [0, 0]
largest_osteophyte_mm = [0.0, 0.0]
subchondral_plate = [1.0, 1.0]
varus_deg = [0.0, 0.0]
""")
    knee = pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table=str(own))
    assert 6.0 <= knee.jsw_medial_mm <= 6.5
    usual = pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table="paper")
    assert (knee.stature_mm, knee.shape, knee.texture_seed) == (usual.stature_mm, usual.shape, usual.texture_seed)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('base = "paper"\n[grade.3]\njsw_medial_mm = [1.0, 2.0]\n', "missing required field"),
        ('base = "nobody"\n', "grade_table must be paper, population, or the path"),
        ('base = "own.toml"\n', "must not be circular"),
        ("base = 3\n", "must be the name or path of a table, got 3"),
        ("body = 3\n", "grades own.toml"),
    ],
)
def test_an_invalid_grade_table_is_rejected(tmp_path, text, message):
    own = tmp_path / "own.toml"
    own.write_text(text)
    with pytest.raises(InputError, match=message):
        pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table=str(own))


def test_an_unknown_grade_or_grade_table_is_rejected():
    with pytest.raises(InputError, match=r"grade must be one of 0, 1, 2 .* got 3: grade table population has it"):
        pssf.sample_knee(grade=3, rng=np.random.default_rng(1), grade_table="paper")
    with pytest.raises(InputError, match="grade_table must be paper, population"):
        pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table="nobody")
    with pytest.raises(InputError, match="got knees with grade 3: grade table population has grade 3"):
        plan_cohort("quick", seed=1, overrides={"knees": [1, 1, 1, 1], "grade_table": "paper"})


def test_population_is_the_default_and_former_table_names_still_work():
    assert pssf.sample_knee(grade=4, rng=1).grade_table == "population"
    with pytest.warns(DeprecationWarning, match="table is now grade_table"):
        earlier = pssf.sample_knee(grade=2, rng=1, table="paper")
    assert earlier == pssf.sample_knee(grade=2, rng=1, grade_table="paper")
    load_grade_table.cache_clear()
    with pytest.warns(DeprecationWarning, match="'people' is now 'population'"):
        earlier = pssf.sample_knee(grade=2, rng=1, grade_table="people")
    assert earlier == pssf.sample_knee(grade=2, rng=1)
    with pytest.warns(DeprecationWarning, match="preset 'people' is now 'population'"):
        assert plan_cohort("people", seed=1, overrides={"knees": [1, 1]}).preset == "population"


def test_a_user_table_changes_only_the_listed_entries_of_its_base(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text('base = "paper"\n[grade.0]\njsw_medial_mm = [6.0, 6.5]\n[pose]\nrotation_deg = [1.0, 1.0]\n')
    table, paper = load_grade_table(str(own)), load_grade_table("paper")
    assert table.grades == paper.grades
    assert table.grade["0"].jsw_medial_mm == (6.0, 6.5)
    assert table.grade["0"].jsw_lateral_mm == paper.grade["0"].jsw_lateral_mm
    assert (table.grade["2"], table.body, table.pose["flexion_deg"]) == (
        paper.grade["2"], paper.body, paper.pose["flexion_deg"],
    )  # fmt: skip
    assert pssf.sample_knee(grade=1, rng=3, grade_table=str(own)).rotation_deg == 1.0
    more = tmp_path / "more.toml"
    more.write_text('base = "own.toml"\n[grade.3]\n' + "\n".join(
        f"{name} = {list(value)}" for name, value in structs.asdict(paper.grade["2"]).items()
    ))  # fmt: skip
    assert load_grade_table(str(more)).grades == (0, 1, 2, 3)
    assert load_grade_table(str(more)).grade["0"] == table.grade["0"]
    by_severity = tmp_path / "severity.toml"
    by_severity.write_text('base = "population"\n[rest]\nwomen = [0.0, 0.0, 0.0, 0.0, 0.0]\n')
    changed, population = load_grade_table(str(by_severity)), load_grade_table("population")
    assert changed.rest.women == (0.0,) * 5
    assert (changed.rest.plate, changed.spaces, changed.body) == (
        population.rest.plate, population.spaces, population.body,
    )  # fmt: skip


def test_subject_numbers_do_not_predict_the_grade():
    for preset, count in (("quick", 24), ("paper", 180), ("population", 250)):
        plan = plan_cohort(preset, seed=0)
        numbers, grades = zip(*((case.subject, case.knee.grade) for case in plan.cases), strict=True)
        assert sorted(set(numbers)) == list(range(count))
        # The rank correlation of independent numbers has a standard deviation of 1 / sqrt(n - 1).
        assert abs(spearmanr(numbers, grades).statistic) < 4 / np.sqrt(len(numbers) - 1)
