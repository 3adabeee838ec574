"""How the documentation's site is built: `sphinx-build -W --keep-going -b html docs build/site`."""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path

from myst_nb.core.execute import cache as notebooks

from amulett_gym import __version__

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

# Notebooks draw their figures into their cells, whatever the machine's own settings are.
os.environ.pop("MPLBACKEND", None)
os.environ["MATPLOTLIBRC"] = str(Path(__file__).parent / "_ext" / "matplotlibrc")

project, author, copyright = "amulett-gym", "The amulett-gym authors", "the amulett-gym authors"
version = release = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_nb",
    "environment_pages",
    "repository_links",
    "live_twin",
    "closed_site",
]
exclude_patterns = ["_ext"]
default_role = "code"  # a name in single backticks

myst_heading_anchors = 4  # with the names that GitHub gives them

# Tutorials are executed once, and again when their own code changes (not the package's: CONTRIBUTING.md); an error in
# one ends the build.
nb_execution_mode = "cache"
nb_execution_timeout = 300  # [s] for a cell, on a busy machine
# [s] for the start of its process, of which 60, the default, are too few beside CI's other work. There is no setting.
notebooks.single_nb_execution = partial(notebooks.single_nb_execution, startup_timeout=300)
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give types, shapes and units
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"amulett-gym {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
