"""The documentation site: `python -m sphinx -W --keep-going -b html docs site`.

The lessons in `notebooks/` are executed while the site is built.  `HSED_LESSONS=off` leaves that out, for a quick look at the
pages; any other value is an execution mode of MyST-NB (`force`, the default, or `cache`).
"""

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
# Beside this file live the two extensions of the site's own.
sys.path.insert(0, str(HERE))

# The lessons are pages as they are.  Through the link they also run where they are, so that their relative paths hold.
lessons = HERE / "lessons"
if not lessons.is_symlink() and (HERE.parent / "notebooks").is_dir():
    lessons.symlink_to(Path("..") / "notebooks", target_is_directory=True)

project = "hsed_jax"
release = version = version_of("hsed_jax")
author = "hsed_jax developers"
language = "en"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_copybutton",
    "docstrings",
    "commands",
]
# Python files are pages among the lessons alone, which begin with a number; what a lesson writes beside them is none.
exclude_patterns = ["*.py", "paper", "lessons/[!0-9]*", "lessons/*.ipynb"]
templates_path = ["_templates"]
highlight_language = "none"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = os.environ.get("HSED_LESSONS", "force")
nb_execution_timeout = 1800
nb_execution_raise_on_error = True
nb_merge_streams = True
# Without execution nobody says in which language a lesson is.
suppress_warnings = ["myst-nb.lexer"]

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 140
napoleon_numpy_docstring = False
# What a class of data holds is listed in its own words, and the names there are no links.
napoleon_custom_sections = [("Attributes", "params_style")]

html_theme = "pydata_sphinx_theme"
html_title = "hsed_jax"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = False
html_domain_indices = False
html_sidebars = {"**": ["contents"]}
html_theme_options = {
    "navbar_center": [],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}
copyright = "the authors of hsed_jax, Apache-2.0"
copybutton_exclude = ".linenos, .gp, .go"
