import pytest

from pssf.accuracy.physics import physics_rows


@pytest.fixture(scope="module")
def physics():
    return {row["quantity"]: row["difference_percent"] for row in physics_rows()}


@pytest.mark.parametrize(
    ("what", "percent", "count"),
    [("attenuation", 0.5, 16), ("fluence", 2.0, 3), ("mean energy", 1.0, 3), ("primary", 5.0, 8)],
)
def test_physics_agrees_with_its_references(physics, what, percent, count):
    found = [difference for name, difference in physics.items() if name.startswith(what)]
    assert len(found) == count
    assert max(map(abs, found)) <= percent


def test_scatter_behind_a_limb_agrees_with_monte_carlo_within_15_percent(physics):
    found = [difference for name, difference in physics.items() if name.startswith("scatter")]
    assert len(found) == 8
    assert max(map(abs, found)) <= 15
