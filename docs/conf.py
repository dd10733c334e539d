"""The site: `make docs` builds it from these pages, docstrings, and the command line's help."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
# The kernels of the tutorials import how their data were simulated.
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(Path(__file__).parent / "tutorials"), os.environ.get("PYTHONPATH", "")]
)

project = "truenewton"
author = "The truenewton developers"
copyright = author
version = release = installed_version("truenewton")

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx-mathjax-offline",
    "site_pages",
]
exclude_patterns = ["_build", "jupyter_execute"]
nitpicky = True
smartquotes = False  # a prime is a transpose
# Overloads stand as they are written, with the alias.
nitpick_ignore_regex = [
    (
        "py:class",
        r"numpy\._typing\..*|astropy\.table\.table\..*|TypeAliasForwardRef|pd\.DataFrame"
        r"|AnyCalibration|Data|Seen|Surface|Array|numpy.str_"
        r"|(collections\.abc\.)?Mapping\[int|tuple\[(float|Cycle)",
    )
]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

os.environ["IPYTHONDIR"] = str(Path(__file__).parent / "ipython")
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300  # [s] a cell, also where the machine has other work
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_type_aliases = {"Array": "numpy.typing.ArrayLike"}
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
numpydoc_show_class_members = False

# Kept in the repository: the site is built from package registries alone.
_HOMES = {
    "astropy": "https://docs.astropy.org/en/stable/",
    "matplotlib": "https://matplotlib.org/stable/",
    "numpy": "https://numpy.org/doc/stable/",
    "python": "https://docs.python.org/3/",
}
intersphinx_mapping = {name: (url, f"inventories/{name}.inv") for name, url in _HOMES.items()}

copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True

html_theme = "pydata_sphinx_theme"
html_title = "truenewton"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_sidebars = {"**": ["globaltoc.html"]}  # all sections, in the order of a learner
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "navbar_center": [],
}
