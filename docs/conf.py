"""Sphinx configuration; `make docs` builds the pages into docs/_build."""

import shutil
import sys
from pathlib import Path

import lunarsci

sys.path.insert(0, str(Path(__file__).parent / "_extension"))

HERE = Path(__file__).parent
(HERE / "notebooks").mkdir(exist_ok=True)
for notebook in (HERE.parent / "examples").glob("*.ipynb"):
    shutil.copy(notebook, HERE / "notebooks")  # Sphinx reads below its own folder only

project = "lunarsci"
author = "lunarsci contributors"
version = release = lunarsci.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx-mathjax-offline",
    "lunarsci_pages",
]
exclude_patterns = ["_build", "jupyter_execute", "_extension", "inbox", "**/.ipynb_checkpoints"]
nitpicky = False
default_role = "code"

myst_enable_extensions = ["deflist", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_url_schemes = {
    "http": None,
    "https": None,
    "doi": "https://doi.org/{{path}}",
}
nb_execution_mode = "off"
nb_merge_streams = True

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"

html_theme = "pydata_sphinx_theme"
html_title = "lunarsci"
html_static_path = ["_static"]
html_css_files = ["lunarsci.css"]
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "logo": {"text": "lunarsci"},
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "limits": []}
