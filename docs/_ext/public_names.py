"""Check that the API page lists exactly the public names of the package."""

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.typing import ExtensionMetadata

import pssf


def check_api_page(app: Sphinx) -> None:
    """Raise an error if reference/api.md differs from ``pssf.__all__``."""
    text = (Path(app.srcdir) / "reference" / "api.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   ([A-Za-z]\w*)$", text, re.MULTILINE))
    public = set(pssf.__all__) - {"__version__"}
    if listed != public:
        raise ExtensionError(
            f"reference/api.md must list every public name exactly once; names that differ: {sorted(listed ^ public)}"
        )


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the check of the API page."""
    app.connect("builder-inited", check_api_page)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
