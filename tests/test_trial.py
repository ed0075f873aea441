"""Test virtual trials: design, plan, run, statistics and power."""

import functools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from msgspec import structs
from scipy import stats
from scipy.spatial import cKDTree

import pssf
from pssf.anatomy.outlines.projected_contours import COMPARTMENT_RANGE
from pssf.core.checks import InputError
from pssf.model.sampling.knee_sampling import load_knee_distributions
from pssf.trial import load_trial_design, make_trial, trial_maker, trial_power, trial_sites, trial_statistics
from pssf.trial.image_appearance import APPEARANCE, measure_appearance
from pssf.trial.minimal_distance import measure_minimal_distances
from pssf.trial.trial_design import CAUSES
from pssf.trial.trial_plan import find_knee_at, plan_radiographs, plan_subject, slow_narrowing
from pssf.trial.trial_run import load_views
from pssf.trial.trial_what_if import change_design, estimate_what_if


@pytest.fixture(scope="module")
def distributions():
    """Load the distributions of the default population."""
    return load_knee_distributions("population")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"subjects": 2}, "subjects must be"),
        ({"visits_months": (0.0, 12.0, 12.0)}, "visits_months must be increasing"),
        ({"visits_months": (6.0, 12.0)}, "begin with 0"),
        ({"views": ()}, "views must be one or more"),
        ({"views": ("lyon_schuss", "lyon_schuss")}, "different names"),
        ({"readers": ("human",)}, "readers must include label"),
        ({"readers": ("label", "eye")}, "readers must be one of"),
        ({"treatment": {"fraction": 1.5, "compartment": "medial", "treated": 0.5}}, "treatment fraction"),
        ({"dropout": {"per_year": 1.0}}, "dropout per_year"),
        ({"sites": []}, "number of sites"),
        ({"seed": -1}, "seed"),
        ({"subjects": "many"}, "trial design must have"),
    ],
)
def test_invalid_designs_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        load_trial_design(**settings)


def test_a_design_file_changes_single_entries(tmp_path):
    path = tmp_path / "trial.toml"
    path.write_text('subjects = 12\n[treatment]\nfraction = 0.3\n[[sites]]\nname = "Paris"\nshare = 1.0\n')
    design = load_trial_design(path, seed=5)
    default = load_trial_design()
    assert (design.subjects, design.seed, design.treatment.fraction) == (12, 5, 0.3)
    assert design.treatment.compartment == default.treatment.compartment
    assert [site.name for site in design.sites] == ["Paris"]
    assert design.population == default.population
    path.write_text("subject = 12\n")
    with pytest.raises(InputError, match=r"entry must be one of .* got 'subject'"):
        load_trial_design(path)


def test_subjects_do_not_depend_on_their_number_and_arms_are_balanced(distributions):
    few, many = load_trial_design(subjects=8), load_trial_design(subjects=400)
    assert plan_subject(few, distributions, 5) == plan_subject(many, distributions, 5)
    for share in (0.25, 0.5, 2 / 3):
        design = structs.replace(many, treatment=structs.replace(many.treatment, treated=share))
        treated = [plan_subject(design, distributions, number).treated for number in range(48)]
        assert sum(treated) == round(48 * share)


def test_the_population_has_the_required_grades_sex_and_body_mass_index(distributions):
    design = load_trial_design(subjects=400)
    design = structs.replace(design, population=structs.replace(design.population, knees=2, bmi=(28.0, 32.0)))
    subjects = [plan_subject(design, distributions, number) for number in range(150)]
    knees = [knee for subject in subjects for knee in subject.knees]
    assert {knee.grade for knee in knees} == {2, 3}
    assert all(28 <= knee.bmi <= 32 for knee in knees)
    assert all({knee.side for knee in subject.knees} == {"right", "left"} for subject in subjects)
    # 99.9 % intervals of binomial counts.
    women = sum(subject.knees[0].sex == "female" for subject in subjects)
    assert stats.binomtest(women, 150, design.population.female).pvalue > 0.001
    severe = sum(subject.knees[0].grade == 3 for subject in subjects)
    assert stats.binomtest(severe, 150, 0.5).pvalue > 0.001
    left = sum(subject.last_month < 24 for subject in subjects)
    assert stats.binomtest(left, 150, 1 - 0.95**2).pvalue > 0.001


@pytest.mark.parametrize("compartment", ["medial", "lateral", "both"])
def test_the_treatment_prevents_the_chosen_fraction_of_the_loss(distributions, compartment):
    design = load_trial_design()
    treatment = structs.replace(design.treatment, compartment=compartment, fraction=0.4)
    first = pssf.sample_knee(grade=3, rng=4)
    later = pssf.progress(first, 4.0, rng=2)
    treated = slow_narrowing(first, later, treatment)
    for side in ("medial", "lateral"):
        lost, kept = (getattr(first, f"jsw_{side}_mm") - getattr(one, f"jsw_{side}_mm") for one in (later, treated))
        assert lost > 0
        assert kept == pytest.approx(lost * (0.6 if compartment in (side, "both") else 1.0), abs=1e-3)
    assert treated.osteophytes == later.osteophytes
    assert slow_narrowing(first, later, structs.replace(treatment, fraction=0.0)) == replace(
        later, grade=None, reader_grade=None
    )
    if compartment == "both":
        tilt, natural = treated.varus_deg - first.varus_deg, later.varus_deg - first.varus_deg
        assert tilt == pytest.approx(0.6 * natural, abs=1e-3)


def test_visits_of_a_subject_follow_one_course(distributions):
    design = load_trial_design(visits_months=(0.0, 12.0, 24.0, 48.0))
    subject = replace(plan_subject(design, distributions, 3), treated=False)
    spaces = [find_knee_at(subject, 0, month, design).jsw_medial_mm for month in design.visits_months]
    assert spaces == sorted(spaces, reverse=True)
    assert spaces[0] - spaces[2] == pytest.approx(2 * (spaces[0] - spaces[1]), abs=1e-3)


@pytest.mark.parametrize("cause", list(CAUSES))
def test_a_cause_that_is_left_out_changes_only_its_own_fields(distributions, cause):
    design = load_trial_design(subjects=4)
    views = load_views(design)
    subject = plan_subject(design, distributions, 1)
    whole = [one for one in plan_radiographs(design, views, subject) if one.labels["month"] == 0]
    without = plan_radiographs(design, views, subject, without=cause)
    assert len(whole) == len(without) == len(views) * design.repeats
    for before, after in zip(whole, without, strict=True):
        assert before.noise_seed == after.noise_seed
        nominal = views[before.labels["view"]]
        changed = {name for name in vars(nominal) if getattr(before.protocol, name) != getattr(after.protocol, name)}
        assert changed <= {*CAUSES[cause], "noise"}
        assert all(getattr(after.protocol, name) == getattr(nominal, name) for name in CAUSES[cause])


def test_a_site_with_perfect_positioning_has_nominal_positions_and_its_own_offset(distributions):
    design = load_trial_design(subjects=4)
    site = structs.replace(design.sites[0], positioning=0.0, beam_offset_deg=2.0)
    design = structs.replace(design, sites=(site,))
    views = load_views(design)
    for one in plan_radiographs(design, views, plan_subject(design, distributions, 0)):
        nominal = views[one.labels["view"]]
        assert one.protocol.beam_angle_deg == pytest.approx(nominal.beam_angle_deg + 2)
        assert one.protocol.rotation_deg == nominal.rotation_deg
        assert one.protocol.sod_mm == nominal.sod_mm


def test_views_must_be_frontal():
    with pytest.raises(InputError, match="views must be frontal views of one knee, got lateral"):
        load_views(load_trial_design(views=("lateral",)))


def _make_radiographs(design, *, knees, error_mm, seed=0):
    """Make a table of radiographs with a known true change and a known measurement error."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(knees):
        treated = subject % 2 == 1
        start, loss = rng.normal(4, 0.8), rng.gamma(2, 0.15)
        for month, repeats in ((0.0, 2), (24.0, 1)):
            true = start - (0 if month == 0 else loss * (1 - design.treatment.fraction * treated))
            for repeat in range(repeats):
                read = true + rng.normal(0, error_mm)
                row = {"subject": subject, "knee": 0, "treated": treated, "month": month, "view": "lyon_schuss"}
                row |= {"repeat": repeat, "without": "", "true_medial_mm": true, "true_lateral_mm": 5.0}
                row |= {f"label_{name}": read for name in ("medial_mm", "lateral_mm", "fixed_mm", "mean_mm")}
                rows.append(row | {"label_narrowing": 1, "inter_margin_mm": rng.normal(0, 1)})
    return pd.DataFrame(rows)


def test_error_and_responsiveness_of_known_measurements_are_recovered():
    design = load_trial_design(readers=("label",), visits_months=(0.0, 24.0), views=("lyon_schuss",))
    table = trial_statistics.summarise_measures(_make_radiographs(design, knees=2000, error_mm=0.3), design)
    row = table.set_index("measure").loc["medial_mm"]
    # The standard error of an SD from n pairs is SD / sqrt(2 n).
    assert row["sem"] == pytest.approx(0.3, abs=4 * 0.3 / np.sqrt(4000))
    assert row["sem_low"] < 0.3 < row["sem_high"]
    assert row["sdd"] == pytest.approx(1.96 * np.sqrt(2) * row["sem"])
    assert row["icc"] == pytest.approx(0.64 / (0.64 + 0.09), abs=0.03)
    assert row["change"] == pytest.approx(-0.3, abs=0.06)
    assert row["change_sd"] == pytest.approx(np.sqrt(2 * 0.15**2 + 2 * 0.09), abs=0.06)
    assert row["difference"] == pytest.approx(0.15, abs=0.07)
    assert row["bias_true"] == pytest.approx(0, abs=0.03)
    spreads = np.sqrt([2 * 0.15**2 + 2 * 0.09, 2 * 0.075**2 + 2 * 0.09])
    assert row["subjects_per_arm"] == pytest.approx(trial_statistics.compute_subjects_per_arm(0.15, *spreads), rel=0.35)
    assert table.set_index("measure").loc["lateral_mm", "subjects_per_arm"] == np.inf


def test_the_number_of_subjects_agrees_with_the_noncentral_t_distribution():
    for effect, sd in ((0.5, 1.0), (0.2, 0.6), (1.0, 1.0)):
        size = trial_statistics.compute_subjects_per_arm(effect, sd, sd)

        def power(n, effect=effect, sd=sd):
            """Compute the power of a two-sided t test with equal variances."""
            freedom = 2 * n - 2
            limit = stats.t.ppf(0.975, freedom)
            shift = effect / sd * np.sqrt(n / 2)
            return stats.nct.sf(limit, freedom, shift) + stats.nct.cdf(-limit, freedom, shift)

        assert power(size) >= 0.8
        assert power(size - 2) < 0.8
    assert trial_statistics.compute_subjects_per_arm(0.0, 1.0, 1.0) == np.inf


def test_too_few_knees_give_no_number_of_subjects():
    design = load_trial_design(readers=("label",), visits_months=(0.0, 24.0), views=("lyon_schuss",))
    table = trial_statistics.summarise_measures(_make_radiographs(design, knees=6, error_mm=0.3), design)
    assert table["subjects_per_arm"].isna().all()


def test_the_share_of_a_cause_is_the_variance_that_it_adds():
    design = load_trial_design(readers=("label",), visits_months=(0.0, 24.0), views=("lyon_schuss",))
    whole = _make_radiographs(design, knees=400, error_mm=0.4)
    less = _make_radiographs(design, knees=400, error_mm=0.2, seed=1).assign(without="beam")
    causes = trial_statistics.decompose_errors(pd.concat([whole, less], ignore_index=True), design)
    row = causes.set_index(["measure", "cause"]).loc[("medial_mm", "beam")]
    assert row["share"] == pytest.approx(0.75, abs=0.08)
    assert row["share_low"] < 0.75 < row["share_high"]
    assert row["sd_all"] == pytest.approx(0.4, abs=0.06)
    assert row["sd_without"] == pytest.approx(0.2, abs=0.03)


def test_alignment_counts_radiographs_and_pairs():
    design = load_trial_design(readers=("label",), visits_months=(0.0, 24.0), views=("lyon_schuss",))
    row = trial_statistics.summarise_alignment(_make_radiographs(design, knees=1000, error_mm=0.1), design).iloc[0]
    share = stats.norm.cdf(1) - stats.norm.cdf(-1)
    assert row["aligned"] == pytest.approx(share, abs=0.05)
    assert row["aligned_twice"] == pytest.approx(share**2, abs=0.06)
    assert row["loss_all"] == pytest.approx(0.15, abs=0.04)


def _make_sites(*, difference_mm, brightness, subjects=200):
    """Make the first radiographs of subjects of two sites with another error and another brightness."""
    rng = np.random.default_rng(1)
    second = np.arange(subjects) % 2 == 1
    true = rng.normal(4.0, 0.8, subjects)
    table = pd.DataFrame(rng.normal(0.5, 0.05, (subjects, len(APPEARANCE))), columns=APPEARANCE)
    table = table.add(brightness * second, axis=0)
    return table.assign(
        view="a", subject=range(subjects), site=np.where(second, "B", "A"), without="", repeat=0, month=0.0,
        true_medial_mm=true, true_lateral_mm=true + 2,
        label_medial_mm=true + rng.normal(0, 0.3, subjects) + difference_mm * second, label_lateral_mm=true + 2,
    )  # fmt: skip


def test_a_difference_between_sites_is_measured_and_harmonised():
    design = load_trial_design(readers=("label",))
    table = trial_sites.summarise_sites(_make_sites(difference_mm=0.5, brightness=0.0), design)
    rows = table.set_index(["measure", "harmonisation"])
    assert rows.loc[("medial_mm", "none"), "difference"] == pytest.approx(0.5, abs=0.13)
    # The variance of the error is 0.3^2 within sites and 0.25^2 between them.
    assert rows.loc[("medial_mm", "none"), "site_share"] == pytest.approx(0.41, abs=0.12)
    # The sites' knees differ by chance, which harmonisation takes for an effect of the site.
    assert rows.loc[("medial_mm", "combat"), "difference"] < 0.3
    assert rows.loc[("lateral_mm", "none"), "difference"] < 1e-9
    low, high = rows.loc[("medial_mm", "none"), ["difference_low", "difference_high"]]
    assert 0.3 < low < 0.5 < high < 0.7


@pytest.mark.parametrize(("brightness", "recognised"), [(0.2, True), (0.0, False)])
def test_sites_are_recognised_by_their_brightness_until_it_is_harmonised(brightness, recognised):
    design = load_trial_design(readers=("label",))
    table = trial_sites.recognise_sites(_make_sites(difference_mm=0.0, brightness=brightness), design)
    rows = table.set_index(["predictors", "harmonisation"])
    assert (rows["chance"] == 0.5).all()
    assert (rows.loc[("image", "none"), "balanced_accuracy"] > 0.95) == recognised
    for other in (("image", "combat"), ("label", "none"), ("label", "combat")):
        assert rows.loc[other, "balanced_accuracy_low"] < 0.55
        assert rows.loc[other, "balanced_accuracy_high"] > 0.45


def test_small_or_single_sites_have_no_estimates():
    design = load_trial_design(readers=("label",))
    few = _make_sites(difference_mm=0.5, brightness=0.2, subjects=18)
    for table in (few, few.assign(site="A")):
        assert trial_sites.summarise_sites(table, design)["difference"].isna().all()
        assert trial_sites.recognise_sites(table, design)["balanced_accuracy"].isna().all()


def test_the_appearance_of_an_image_follows_its_grey_values_sharpness_and_noise():
    rng = np.random.default_rng(0)
    plane = np.linspace(20_000, 40_000, 401)[:, None] + np.zeros(401)
    noisy = (plane + rng.normal(0, 300, plane.shape)).round().astype(np.uint16)
    clean = measure_appearance(plane.round().astype(np.uint16), (200.0, 200.0), 0.2)
    assert clean["grey_mean"] == pytest.approx(30_000 / 65_535, rel=1e-3)
    assert clean["grey_gradient"] == pytest.approx(50 / 0.2 / 65_535, rel=0.01)
    assert clean["grey_noise"] < 2 / 65_535
    assert measure_appearance(noisy, (200.0, 200.0), 0.2)["grey_noise"] == pytest.approx(300 / 65_535, rel=0.02)


def test_the_minimal_distance_equals_the_smallest_distance_of_sampled_points(built, knee):
    meshes = {surface.name: surface.mesh_arrays for surface in built.scene.surfaces}
    half = built.assembly.bone_parameters.half_ml_mm
    for side, distance in zip((1, -1), measure_minimal_distances(built), strict=True):
        parts = []
        for name in ("femur", "tibia"):
            x = side * meshes[name].vertices[:, 0] / half
            inside = meshes[name].vertices[(COMPARTMENT_RANGE[0] < x) & (x < COMPARTMENT_RANGE[1])]
            parts.append(inside[np.abs(inside[:, 2]) < 14])
        nearest = cKDTree(parts[0]).query(parts[1])[0].min()
        # Vertices are up to 2 mm apart, so that the nearest vertices are slightly farther apart than the surfaces.
        assert distance <= nearest + 1e-9
        assert distance > nearest - 0.3


def test_a_what_if_with_unchanged_values_gives_the_same_measures(small_trial, small_design):
    radiographs = pd.read_csv(small_trial / "radiographs.csv").fillna({"without": ""})
    same = estimate_what_if(
        radiographs, small_design, change_design(small_design, {"fraction": small_design.treatment.fraction})
    )
    measures = pd.read_csv(small_trial / "measures.csv")
    pd.testing.assert_series_equal(same["sem"].astype(float), measures["sem"], check_exact=False, rtol=1e-9)
    assert not {"difference", "p"} & set(same)


def test_a_what_if_changes_the_error_of_the_human_reader():
    design = load_trial_design(readers=("label", "human"), visits_months=(0.0, 24.0), views=("lyon_schuss",))
    table = _make_radiographs(design, knees=600, error_mm=0.3)
    rng = np.random.default_rng(3)
    for name in ("medial_mm", "lateral_mm", "fixed_mm", "mean_mm", "narrowing"):
        table[f"human_{name}"] = table[f"label_{name}"] + rng.normal(0, design.human.sd_mm, len(table))
    changes = {"human_sd_mm": 0.4, "human_bias_mm": 0.5, "fraction": 1.0}
    changed = estimate_what_if(table, design, change_design(design, changes))
    row = changed.set_index(["reader", "measure"]).loc[("human", "medial_mm")]
    assert row["sem"] == pytest.approx(np.hypot(0.3, 0.4), rel=0.06)
    assert row["bias_projected"] == pytest.approx(0.5, abs=0.05)
    whole = estimate_what_if(table, design, design).set_index(["reader", "measure"])
    label = changed.set_index(["reader", "measure"]).loc[("label", "medial_mm"), "subjects_per_arm"]
    # The number of knees is inversely proportional to the square of the effect.
    ratio = whole.loc[("label", "medial_mm"), "subjects_per_arm"] / label
    assert ratio == pytest.approx((1 / design.treatment.fraction) ** 2, rel=0.1)


@pytest.mark.parametrize(
    ("changes", "readers", "message"),
    [
        ({"dose": 1.0}, ("label", "human"), "what-if change must be"),
        ({"fraction": 1.5}, ("label", "human"), "treatment fraction must be"),
        ({"human_sd_mm": 0.1}, ("label",), "human reader must be part of the trial"),
    ],
)
def test_invalid_what_if_changes_are_refused_before_the_trial_runs(changes, readers, message, tmp_path):
    design = load_trial_design(readers=readers, visits_months=(0.0, 24.0), views=("lyon_schuss",))
    with pytest.raises(InputError, match=message):
        make_trial(design, tmp_path / "trial", what_if=changes, workers=1)
    assert not (tmp_path / "trial").exists()


def test_planned_trials_find_the_treatment_and_rarely_an_effect_that_is_not_there():
    design = load_trial_design(subjects=4)
    measures = pd.DataFrame({"view": ["a"], "reader": ["label"], "measure": ["medial_mm"], "sem": [0.3]})
    table = trial_power.check_power(design, measures, pool=300, trials=400)
    assert list(table["view"]) == [trial_power.TRUE, "a"]
    assert (table["power_low"] < 0.85).all()
    assert (table["power_high"] > 0.75).all()
    assert (table["false_positives_low"] < 0.05).all()
    assert (table["false_positives_high"] > 0.03).all()
    assert table["subjects_per_arm"].is_monotonic_increasing
    no_effect = structs.replace(design, treatment=structs.replace(design.treatment, fraction=0.0))
    assert trial_power.check_power(no_effect, measures, pool=300).empty


@pytest.fixture(scope="module")
def small_design():
    """Return a design that simulates no image."""
    return load_trial_design(
        subjects=4, readers=("label", "human"), views=("fixed_flexion",), visits_months=(0.0, 12.0), cause_subjects=1
    )


@pytest.fixture(scope="module", autouse=True)
def _few_planned_trials():
    """Check the power of each trial of this module with few planned trials, except where a test sets their number."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial_maker, "check_power", functools.partial(trial_power.check_power, pool=20, trials=10))
        yield


@pytest.fixture(scope="module")
def small_trial(small_design, tmp_path_factory):
    """Run a small trial."""
    folder = tmp_path_factory.mktemp("trial")
    make_trial(small_design, folder, without=("beam",), workers=1)
    return folder


def test_a_trial_writes_its_tables_and_report(small_trial, small_design):
    radiographs = pd.read_csv(small_trial / "radiographs.csv")
    assert set(radiographs["month"]) <= {0.0, 12.0}
    assert (radiographs["without"] == "beam").sum() == small_design.repeats
    assert np.isfinite(radiographs["label_medial_mm"]).all()
    first = radiographs[(radiographs["month"] == 0) & (radiographs["repeat"] == 0) & radiographs["without"].isna()]
    assert list(radiographs.index[radiographs["distance_medial_mm"].notna()]) == list(first.index)
    assert (first["distance_medial_mm"] < first["true_medial_mm"] + 0.1).all()
    reading_error = radiographs["human_medial_mm"] - radiographs["label_medial_mm"]
    assert reading_error.abs().max() < 5 * small_design.human.sd_mm
    assert reading_error.std() > 0
    assert {path.name for path in small_trial.iterdir()} == {
        *("trial.json", "trial.html", "radiographs.csv", "measures.csv", "causes.csv", "alignment.csv"),
        *("planned_power.csv", "sites.csv", "site_recognition.csv", "subjects"),
    }
    assert "Virtual trial" in (small_trial / "trial.html").read_text(encoding="utf-8")


def test_a_finished_trial_is_not_simulated_again_and_keeps_its_bytes(small_trial, small_design, monkeypatch):
    before = {path: path.read_bytes() for path in sorted(small_trial.rglob("*")) if path.is_file()}

    def refuse(*args, **kwargs):
        """Fail if a knee is built."""
        raise AssertionError("a subject was simulated again")

    monkeypatch.setattr("pssf.trial.trial_measurement.build", refuse)
    make_trial(small_design, small_trial, without=("beam",), workers=1)
    assert before == {path: path.read_bytes() for path in sorted(small_trial.rglob("*")) if path.is_file()}


def test_another_design_does_not_replace_a_trial(small_trial, small_design):
    with pytest.raises(InputError, match="contains a different trial"):
        make_trial(structs.replace(small_design, seed=9), small_trial, workers=1)
