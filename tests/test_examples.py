"""Check that every script in examples/ runs."""

import importlib.util
from pathlib import Path

import pytest

# One knee per grade is enough.
FEWER = {"population": {"knees_per_grade": 1}}
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_writes_the_files_that_it_returns(path, tmp_path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = module.run(tmp_path, pixels=128, **FEWER.get(path.stem, {}))
    assert written
    assert all(file.stat().st_size > 0 for file in written)
