"""Check that every script in examples/ runs."""

import importlib.util
from pathlib import Path

import pytest

# Examples that build several knees run with the slow tests; a type checker compares their calls with the package.
SLOW = {
    *("counterfactual", "doses_and_tilts", "knee_replacement", "population", "read_labels", "readme_picture"),
    *("train_monai", "train_torchio", "views", "visits"),
}
# Few knees are enough.
FEWER = {
    "population": {"knees_per_grade": 1},
    "train_monai": {"pixels": 256, "images": 2},
    "train_pytorch": {"pixels": 256, "images": 4},
    "train_torchio": {"pixels": 512, "images": 8},
}
# Packages that examples need and that the package does not require.
NEEDED = {"train_monai": "monai", "train_pytorch": "torch", "train_torchio": "torchio"}
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem) for path in EXAMPLES],
)
def test_every_example_writes_the_files_that_it_returns(path, tmp_path):
    if path.stem in NEEDED:
        pytest.importorskip(NEEDED[path.stem], reason=f"{NEEDED[path.stem]} is not installed")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = module.run(tmp_path, **{"pixels": 128, **FEWER.get(path.stem, {})})
    assert written
    assert all(file.stat().st_size > 0 for file in written)
