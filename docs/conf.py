"""How Sphinx makes the site, see `make docs`: pages of this folder, and a reference that is generated."""

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
sys.path.insert(0, str(ROOT))

from tools.site import api, command_line, configuration, messages  # noqa: E402

project = "imolo"
copyright = "imolo's authors, BSD-3-Clause"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]
suppress_warnings = ["myst.xref_missing.none"]
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!imolo\.).*"),  # of other projects, and what a docstring calls its arguments
    ("py:obj", r"imolo\.(actuators|backends|planners|robots|tasks)"),  # groups of entry points
    ("py:class", r".*\.(Annotated|AnyModel|Config|Content|Item|Plugin|Result|Task)"),  # variables of types
    ("py:class", r".*\._\w+|imolo\.method\.hit_kernel\..*"),  # private, and compiled
]

html_theme = "furo"
html_title = "imolo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_show_sourcelink = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True

myst_heading_anchors = 4

autodoc_default_options = {
    "members": True,
    "undoc-members": True,
    "member-order": "bysource",
    "exclude-members": "model_config",
}
autodoc_typehints = "description"
autodoc_use_type_comments = False
default_role = "py:obj"
napoleon_use_ivar = True
napoleon_numpy_docstring = False


def _generate(app: Any, page: str, source: list[str]) -> None:
    """Put what is generated where a page says `<!-- generated: NAME -->`."""
    pages = {
        "command_line": command_line.page,
        "configuration": configuration.page,
        "messages": messages.page,
        "demo_table": lambda: re.search(r"^\| backend .*?\n\n", README.read_text("utf-8"), re.MULTILINE | re.DOTALL)[0],
    }
    source[0] = re.sub(r"<!-- generated: (\w+) -->", lambda found: pages[found[1]](), source[0])


def _escape(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Keep |v| what it is in our docstrings: the size of v."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app: Any) -> None:
    """Connect what is generated."""
    api.write(Path(__file__).parent / "reference/api")
    app.connect("source-read", _generate)
    app.connect("autodoc-process-docstring", _escape)
