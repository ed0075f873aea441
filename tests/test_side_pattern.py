"""Check the edge pattern that distinguishes right from left knees: training, and the pattern of the package."""

import tomllib

import numpy as np
import pytest
from tools import side_pattern_fit

from pssf.data.analysis.localisation_table import load_localisation_settings

TABLE = load_localisation_settings()


def test_side_weights_are_evaluated_on_held_out_knees(monkeypatch):
    shape, rng = np.array([TABLE.sides.down, TABLE.sides.right]).shape, np.random.default_rng(0)
    usual = rng.standard_normal(shape) * 0.1

    def compute_edges(number, **shared):
        return usual + np.random.default_rng(number).standard_normal(shape) if number != 3 else None

    monkeypatch.setattr(
        side_pattern_fit, "map_in_parallel", lambda f, jobs, shared, workers: [f(n, **shared) for n in jobs]
    )
    monkeypatch.setattr(side_pattern_fit, "_compute_knee_edges", compute_edges)
    weights, evidence = side_pattern_fit.train_side_pattern(200, 0, 1, TABLE)
    assert (weights.shape, evidence.shape) == (shape, (199,))
    assert np.corrcoef(weights.ravel(), usual.ravel())[0, 1] > 0.5
    # Evidence is normalised to a mean of 1 over held-out knees; a fit to all knees would give higher values.
    np.testing.assert_allclose(evidence.mean(), 1.0, rtol=1e-12)
    assert (weights * usual).sum() > 1.0
    table = tomllib.loads(side_pattern_fit.format_pattern_toml(weights, 199, 2))
    np.testing.assert_allclose([table["down"], table["right"]], weights, atol=5e-5)
    assert table["block"] == 2


@pytest.mark.slow
def test_edges_of_sampled_left_and_right_knees_give_the_same_evidence(monkeypatch):
    weights = np.array([TABLE.sides.down, TABLE.sides.right])
    sampled = {}
    sample = side_pattern_fit._sample_knee_and_protocol

    def sample_and_record(number, rng, modes):
        sampled[number] = sample(number, rng, modes)
        return sampled[number]

    monkeypatch.setattr(side_pattern_fit, "_sample_knee_and_protocol", sample_and_record)
    shared = {"templates": side_pattern_fit.make_standard_templates("scanline"), "modes": 0, "table": TABLE}
    for number in (0, 3, 7, 10):
        assert (weights * side_pattern_fit._compute_knee_edges(number, **shared)).sum() > 0.2
    assert {knee.side for knee, _ in sampled.values()} == {"left", "right"}
    assert {protocol.name for _, protocol in sampled.values()} > {"fixed_flexion", "ap_standing"}
