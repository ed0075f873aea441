"""What Python loads before anything is asked for: a time would depend on the machine, a list of modules does not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

# None of these is needed to name the package's functions, or to say what its commands are.
HEAVY = (
    "scipy", "numba", "pandas", "matplotlib", "trimesh", "xraylib", "spekpy", "manifold3d", "embreex", "pydicom",
    "sklearn", "radiomics", "dask",
)  # fmt: skip
IMPORT = "import pssf"
HELP = """
import contextlib, io
from pssf.cli import main
sys.argv = ["pssf", "--help"]
with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):
    main()
assert "simulate" in said.getvalue()
"""


def loaded_by(code):
    """Names of the modules that a fresh interpreter has loaded after some code."""
    whole = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", whole], capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# A third more than were counted (66 and 155 with Python 3.11); with the package all at once they were 1,458.
@pytest.mark.parametrize(("code", "most"), [(IMPORT, 90), (HELP, 210)], ids=["import", "help"])
def test_nothing_heavy_is_loaded_before_it_is_asked_for(code, most):
    modules = loaded_by(code)
    assert not {name.split(".")[0] for name in modules} & set(HEAVY)
    assert len(modules) <= most


def test_what_is_loaded_is_seen_once_it_is_asked_for():
    assert {"scipy", "manifold3d"} <= set(loaded_by(f"{IMPORT}\npssf.build"))
