import importlib.util
from pathlib import Path

import pytest

# Of each grade one knee is enough.
FEWER = {"people": {"each": 1}}
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_runs_and_writes_what_it_returns(path, tmp_path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = module.run(tmp_path, pixels=128, **FEWER.get(path.stem, {}))
    assert written
    assert all(file.stat().st_size > 0 for file in written)
