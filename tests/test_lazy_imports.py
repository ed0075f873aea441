"""Modules loaded at import and by the help text; unlike a time, they do not depend on the machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

# None of these is needed to import the package or to print the help text.
HEAVY = (
    "scipy", "numba", "pandas", "matplotlib", "trimesh", "xraylib", "spekpy", "manifold3d", "embreex", "pydicom",
    "sklearn", "radiomics", "dask",
)  # fmt: skip
IMPORT = "import pssf"
HELP = """
import contextlib, io
from pssf.cli import main
sys.argv = ["pssf", "--help"]
with contextlib.redirect_stdout(io.StringIO()) as output, contextlib.suppress(SystemExit):
    main()
assert "simulate" in output.getvalue()
"""


def list_loaded_modules(code):
    """List the modules that a new interpreter has loaded after some code."""
    whole = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", whole], capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# The limits are a third above the counts with Python 3.11 (66 and 155); importing the whole package gives 1,458.
@pytest.mark.parametrize(("code", "most"), [(IMPORT, 90), (HELP, 210)], ids=["import", "help"])
def test_heavy_libraries_are_not_loaded_at_import_or_by_the_help(code, most):
    modules = list_loaded_modules(code)
    assert not {name.split(".")[0] for name in modules} & set(HEAVY)
    assert len(modules) <= most


def test_the_list_of_loaded_modules_detects_lazy_imports():
    assert {"scipy", "manifold3d"} <= set(list_loaded_modules(f"{IMPORT}\npssf.build"))
