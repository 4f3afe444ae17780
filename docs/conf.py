"""Configuration of the documentation: `make docs` builds it, without a network."""

from __future__ import annotations

import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from sphinx.domains.python import PyObject

import tominpmp

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "extensions")]

project = "tominpmp"
author = "the tominpmp developers"
project_copyright = author
release = version = metadata.version("tominpmp")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    # Of docs/extensions.
    "csv_tables",
    "from_the_code",
    "mathml",
    "playback_pages",
]
exclude_patterns = ["build", "extensions"]
html_theme = "furo"
html_title = "tominpmp"
html_static_path = ["static"]
html_css_files = ["own.css"]
html_js_files = [("own.js", {"defer": "defer"})]
html_theme_options = {
    "sidebar_hide_name": False,
    "light_css_variables": {"color-brand-primary": "#12375f"},
}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
# A line that begins with a per cent sign is text, as on GitHub, not a comment.
myst_disable_syntax = ["myst_line_comment"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
# Attributes are documented once, in the docstring of their class.
napoleon_use_ivar = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False

# Text that napoleon would take for "type: text" in the first line of a property, and
# its notation of the type of an array.
COLON, ARRAY = "\N{RATIO}", "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]"


def before_napoleon(*event: Any) -> None:
    """Keep the colons of properties."""
    what, lines = event[1], event[5]
    if what == "property" and lines:
        lines[0] = lines[0].replace(":", COLON)


TYPE = re.compile(r"^:(?:var|r)?type\b")
OWN_TYPE = re.compile(r"\btominpmp\.[\w.]*?\b([A-Z]\w*)")
PAGE = re.compile(r"``docs/([\w/]+)\.md``")


def own_type(found: re.Match[str]) -> str:
    """A type of the package by its public name, or by its last one if it has none."""
    name = found[1]
    return f"~tominpmp.{name}" if name in tominpmp.__all__ else name


def after_napoleon(*event: Any) -> None:
    """Put colons back, name types as the code does, and link to pages."""
    lines = event[5]
    for number, line in enumerate(lines):
        text = PAGE.sub(r":doc:`/\1`", line.replace(COLON, ":"))
        if TYPE.match(text):
            text = text.replace(ARRAY, "Array").replace("pinocchio_pywrap_default.", "")
            text = OWN_TYPE.sub(own_type, text).replace("collections.abc.", "")
        lines[number] = text


def setup(app: Any) -> None:
    """Connect the handlers before and after napoleon, whose priority is 500."""
    for kind in PyObject.doc_field_types:
        if kind.name == "variable":
            kind.label = "Attributes"
    app.connect("autodoc-process-docstring", before_napoleon, priority=400)
    app.connect("autodoc-process-docstring", after_napoleon, priority=600)


# Notebooks are run when the pages are built; their output is in the page.
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "build" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True

# Links within the pages are checked by every build (warnings are errors); external
# links by `make docs-links`, which needs a network.
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_anchors = False
