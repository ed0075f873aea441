"""Tables of grades: paper's ranges, people's overlap, and one of a user's own."""

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
def people():
    return {
        grade: [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng((grade, k)), grade_table="population")
            for k in range(COUNT)
        ]
        for grade in range(5)
    }


def definite(knee):
    return [one for one in knee.osteophytes if one.site in MARGINS and one.size_mm >= 0.8]


def test_tables_of_the_package_have_their_grades():
    assert list_grade_tables() == ["paper", "population"]
    assert load_grade_table("paper").grades == (0, 1, 2)
    assert load_grade_table("population").grades == (0, 1, 2, 3, 4)


def test_a_grade_is_what_kellgren_and_lawrence_say(people):
    assert not any(definite(knee) for knee in people[0])
    assert all(one.size_mm <= 1.2 for knee in people[1] for one in definite(knee))
    assert all(definite(knee) for grade in (2, 3, 4) for knee in people[grade])
    assert all(knee.jsw_definition == "read" for knees in people.values() for knee in knees)


def test_the_space_alone_tells_grades_apart_no_better_than_in_people(people):
    # What least gaps on films are of spaces, middles of what people.toml says; what bones and takings add is left out.
    least = {
        grade: [min(1.05 * knee.jsw_medial_mm + 0.45, 0.92 * knee.jsw_lateral_mm + 0.85) for knee in knees]
        for grade, knees in people.items()
    }
    auc = {g: mannwhitneyu(least[0], least[g]).statistic / COUNT**2 for g in range(1, 5)}
    # People's intervals as they are; but for grade 2, which lies at the lower end: one standard error of so many knees.
    error = {1: 0.0, 2: np.sqrt(1 / (6 * COUNT)), 3: 0.0, 4: 0.0}
    for grade, value in auc.items():
        _, low, high = load_landmark_reference().gap_alone_auc[f"kl{grade}"]
        assert low - error[grade] <= value <= high, (grade, value)


def test_parameters_overlap_and_go_with_one_another(people):
    size = {g: np.array([sum(one.size_mm for one in knee.osteophytes) for knee in people[g]]) for g in people}
    assert np.mean(np.subtract.outer(size[3], size[2]) > 0) < 0.95
    least = np.array([min(knee.jsw_medial_mm, knee.jsw_lateral_mm) for knee in people[3]])
    assert np.corrcoef(size[3], least)[0, 1] < 0
    medial, lateral = (
        np.array([getattr(knee, f"jsw_{side}_mm") for knee in people[0]]) for side in ("medial", "lateral")
    )
    assert np.corrcoef(medial, lateral)[0, 1] == pytest.approx(0.58, abs=4 * 0.66 / np.sqrt(COUNT))


def test_osteophytes_come_medially_before_laterally_and_on_the_tibia_before_the_femur(people):
    for grade in (2, 3, 4):
        sites = [{one.site for one in definite(knee)} for knee in people[grade]]
        share = {margin: np.mean([margin in of_one for of_one in sites]) for margin in MARGINS}
        for bone in ("tibia", "femur"):
            assert share[f"medial_{bone}"] > share[f"lateral_{bone}"]
        # Two standard errors of the difference of shares.
        for side in ("medial", "lateral"):
            assert share[f"{side}_tibia"] > share[f"{side}_femur"] - 2 * np.sqrt(0.5 / COUNT)


def test_lips_curve_to_either_way(people):
    curves = np.array([one.curve_deg for knee in people[4] for one in definite(knee)])
    assert 0.1 < np.mean(curves < 0) < 0.9


def test_no_single_parameter_but_osteophytes_gives_doubtful_or_mild_away(people):
    numbers = [name for name, value in vars(people[0][0]).items() if isinstance(value, float)]
    assert {"subchondral_plate", "notch_growth_mm", "effusion_mm", "varus_deg", "subluxation_mm", "bmi"} <= set(numbers)
    for name in numbers:
        healthy, doubtful, mild = (np.array([getattr(knee, name) for knee in people[grade]]) for grade in range(3))
        for grade, other in ((1, doubtful), (2, mild)):
            auc = mannwhitneyu(healthy, other).statistic / COUNT**2
            assert abs(auc - 0.5) < 0.25, (name, grade)


def test_what_severity_moves_goes_together_within_a_grade(people):
    narrowed_medially = [knee for knee in people[4] if knee.jsw_medial_mm < knee.jsw_lateral_mm]
    names = ("subchondral_plate", "varus_deg", "notch_growth_mm", "subluxation_mm", "effusion_mm")
    together = np.corrcoef([[getattr(knee, name) for knee in narrowed_medially] for name in names])
    # Each follows severity with 0.45: two go together with 0.2, less where values are cut off; 10 pairs of 280 knees.
    assert together[np.triu_indices(5, 1)].mean() > 0.2 - 4 / np.sqrt(10 * 280)


@pytest.mark.parametrize("kappa", [0.4, 0.75, 1.0])
def test_a_reader_is_off_by_one_at_most_and_as_often_as_kappa_says(kappa):
    rng = np.random.default_rng(3)
    meant = np.repeat(np.arange(5), 2000)
    read = np.array([sample_reader_grade(int(grade), kappa, 5, rng) for grade in meant])
    assert abs(read - meant).max() <= 1
    agree = np.mean(read == meant)
    chance = sum(np.mean(read == grade) * np.mean(meant == grade) for grade in range(5))
    assert (agree - chance) / (1 - chance) == pytest.approx(kappa, abs=4 * 0.6 / np.sqrt(len(meant)))


def test_a_table_changes_one_value_of_its_base_and_no_other_draw():
    paper, people = load_grade_table("paper"), load_grade_table("population")
    assert list(people.body) == list(paper.body)
    assert {name for name in paper.body if paper.body[name] != people.body[name]} == {"tibial_slope_deg"}


def test_bone_is_denser_and_bodies_heavier_with_grade_by_what_the_table_says():
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
        apart = [getattr(high, name) - getattr(low, name) for low, high in zip(*knees, strict=True)]
        np.testing.assert_allclose(apart, by, atol=2e-4)


def test_a_table_of_ones_own_takes_the_body_from_its_base(tmp_path):
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
    ("text", "said"),
    [
        ('base = "paper"\n[grade.3]\njsw_medial_mm = [1.0, 2.0]\n', "missing required field"),
        ('base = "nobody"\n', "grade_table must be paper, population, or the path"),
        ('base = "own.toml"\n', "must not lead back to itself"),
        ("base = 3\n", "must be the name or path of a table, got 3"),
        ("body = 3\n", "grades own.toml"),
    ],
)
def test_what_is_no_table_of_grades_is_refused(tmp_path, text, said):
    own = tmp_path / "own.toml"
    own.write_text(text)
    with pytest.raises(InputError, match=said):
        pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table=str(own))


def test_a_grade_or_table_that_there_is_not_is_refused():
    with pytest.raises(InputError, match=r"grade must be one of 0, 1, 2 .* got 3: grade table population has it"):
        pssf.sample_knee(grade=3, rng=np.random.default_rng(1), grade_table="paper")
    with pytest.raises(InputError, match="grade_table must be paper, population"):
        pssf.sample_knee(grade=0, rng=np.random.default_rng(1), grade_table="nobody")
    with pytest.raises(InputError, match="got knees of grade 3: grade table population has grade 3"):
        plan_cohort("quick", seed=1, overrides={"knees": [1, 1, 1, 1], "grade_table": "paper"})


def test_the_default_table_has_all_grades_and_earlier_names_still_work():
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


def test_a_table_with_a_base_gives_only_what_differs(tmp_path):
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


def test_the_number_of_a_subject_predicts_no_grade():
    for preset, count in (("quick", 24), ("paper", 180), ("population", 250)):
        plan = plan_cohort(preset, seed=0)
        numbers, grades = zip(*((case.subject, case.knee.grade) for case in plan.cases), strict=True)
        assert sorted(set(numbers)) == list(range(count))
        # The rank correlation of independent numbers has a standard deviation of 1 / sqrt(n - 1).
        assert abs(spearmanr(numbers, grades).statistic) < 4 / np.sqrt(len(numbers) - 1)
