"""Check which modules `import pssf` and the help text load; unlike run times, modules do not depend on the computer."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

# Libraries that are not needed to import the package or to print the help text.
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
    """List the modules that are loaded in a new interpreter after running code."""
    whole = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", whole], capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# The limits are a third above the counts with Python 3.11 (66 and 211); all modules of the package load 1,458.
@pytest.mark.parametrize(("code", "most"), [(IMPORT, 90), (HELP, 280)], ids=["import", "help"])
def test_neither_import_nor_help_loads_heavy_libraries(code, most):
    modules = list_loaded_modules(code)
    assert not {name.split(".")[0] for name in modules} & set(HEAVY)
    assert len(modules) <= most


def test_the_list_of_loaded_modules_detects_lazy_imports():
    assert {"scipy", "manifold3d"} <= set(list_loaded_modules(f"{IMPORT}\npssf.build"))
