"""Configure the documentation site.

Build the site with one command, in the source folder::

    uv run --group docs sphinx-build -W --keep-going -j 1 docs docs/_build/html
"""

import os
import sys
from importlib.metadata import version as find_version
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "_ext"))

from gallery_sources import write_gallery_sources  # noqa: E402

# One OpenMP thread is enough, because the images of the tutorials are small.
os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "PSSF"
author = "PSSF contributors"
copyright = "PSSF contributors, MIT licence"
version = release = find_version("pssf")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "sphinx_design",
    "command_line",
    "mathml_formulas",
    "field_lists",
    "column_lists",
    "public_names",
    "class_signatures",
    "axes_drawing",
    "check_links",
    "measured_tables",
]
exclude_patterns = [
    "_build",
    "_ext",
    "_gallery_src",
    "tutorials",
    "Thumbs.db",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
]
templates_path = ["_templates"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
root_doc = "index"
# Straight quotation marks are kept, because texts contain values such as "AP".
smartquotes = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist", "attrs_inline"]
myst_heading_anchors = 3

autosummary_generate = True
autosummary_imported_members = True
autodoc_typehints = "none"
# The documentation describes pssf.torch also where PyTorch is not installed.
autodoc_mock_imports = ["torch"]
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = False

# With MathML, the pages need no file from another host.
html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = f"PSSF {release}"
html_static_path = ["_static"]
html_css_files = ["pssf.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "PSSF"},
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
    "show_prev_next": False,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": []},
}
html_sidebars = {"index": []}
pygments_style = "tango"

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

write_gallery_sources(DOCS)
sphinx_gallery_conf = {
    "examples_dirs": [str(DOCS / "tutorials"), str(DOCS / "_gallery_src")],
    "gallery_dirs": ["auto_tutorials", "auto_gallery"],
    # Only the tutorials are executed in a build, because the tests execute the scripts of the gallery.
    "filename_pattern": r"tutorials",
    "ignore_pattern": r"__init__\.py",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "plot_gallery": True,
    "abort_on_example_error": False,
    "min_reported_time": 10_000,
    "thumbnail_size": (400, 300),
    "capture_repr": ("_repr_html_", "__repr__"),
    "reset_modules": ("matplotlib",),
    "image_scrapers": ("matplotlib",),
}

linkcheck_ignore = [r"https?://localhost.*", r"tcp://.*", r"http://127\..*"]
linkcheck_anchors = False
linkcheck_timeout = 15
