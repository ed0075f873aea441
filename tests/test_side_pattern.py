"""By what a right knee is told from a left one: learnt anew from a few, and what the package has."""

import tomllib

import numpy as np

from pssf.data.analysis.localisation_table import load_localisation_settings
from pssf.validation.study_methods import side_pattern_fit

TABLE = load_localisation_settings()


def test_weights_are_of_the_mirrored_edges_and_told_by_knees_that_were_not_learnt_from(monkeypatch):
    shape, rng = np.array([TABLE.sides.down, TABLE.sides.right]).shape, np.random.default_rng(0)
    usual = rng.standard_normal(shape) * 0.1

    def of_knee(number, **shared):
        return usual + np.random.default_rng(number).standard_normal(shape) if number != 3 else None

    monkeypatch.setattr(
        side_pattern_fit, "map_in_parallel", lambda f, jobs, shared, workers: [f(n, **shared) for n in jobs]
    )
    monkeypatch.setattr(side_pattern_fit, "_compute_knee_edges", of_knee)
    weights, evidence = side_pattern_fit.train_side_pattern(200, 0, 1, TABLE)
    assert (weights.shape, evidence.shape) == (shape, (199,))
    assert np.corrcoef(weights.ravel(), usual.ravel())[0, 1] > 0.5
    # Of those that were not learnt from: the mean is the unit, and less than what is fitted to all gives.
    np.testing.assert_allclose(evidence.mean(), 1.0, rtol=1e-12)
    assert (weights * usual).sum() > 1.0
    table = tomllib.loads(side_pattern_fit.format_pattern_toml(weights, 199, 2))
    np.testing.assert_allclose([table["down"], table["right"]], weights, atol=5e-5)
    assert table["block"] == 2


def test_edges_of_a_drawn_left_knee_are_as_a_right_ones(monkeypatch):
    weights = np.array([TABLE.sides.down, TABLE.sides.right])
    seen = {}
    drawn = side_pattern_fit._sample_knee_and_protocol

    def remembered(number, rng, modes):
        seen[number] = drawn(number, rng, modes)
        return seen[number]

    monkeypatch.setattr(side_pattern_fit, "_sample_knee_and_protocol", remembered)
    shared = {"templates": side_pattern_fit.make_standard_templates("scanline"), "modes": 0, "table": TABLE}
    for number in (0, 3, 7, 10):
        assert (weights * side_pattern_fit._compute_knee_edges(number, **shared)).sum() > 0.2
    assert {knee.side for knee, _ in seen.values()} == {"left", "right"}
    assert {protocol.name for _, protocol in seen.values()} > {"fixed_flexion", "ap_standing"}
