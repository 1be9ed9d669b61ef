"""The documentation site: `python -m sphinx -W --keep-going -b html docs site`.

The notebooks are pages with the outputs that they hold; `.ci/notebooks.py` executes them and compares.
"""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
# Beside this file live the two extensions of the site's own.
sys.path.insert(0, str(HERE))

# The notebooks are pages as they are.
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
# Files that a notebook writes beside the notebooks are not pages.
exclude_patterns = ["*.py", "paper", "lessons/[!0-9]*"]
templates_path = ["_templates"]
highlight_language = "none"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "off"
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 140
napoleon_numpy_docstring = False
# The docstring of a data class lists its fields; their names are not links.
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
