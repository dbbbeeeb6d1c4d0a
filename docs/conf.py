"""The site: `make docs` builds it, and a test does with every warning as an error."""

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What is documented is this checkout, whatever is installed.
sys.path[:0] = [str(ROOT), str(ROOT / "envs"), str(Path(__file__).parent / "_ext")]

ALIASES = (
    *("FloatArray", "Float32Array", "IntArray", "Int32Array", "ByteArray", "BoolArray", "ArrayLike"),
    *("Attitude", "ContactGeometry", "GazeboTerrain", "Method", "NoiseLevel", "Progress", "Rays"),
    *("Storage", "Unknown", "Vector3"),
)
"""Types that signatures show by their name."""

project = "LIRS-WCT"
release = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
copyright = "the LIRS-WCT developers"
extensions = [
    *("myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"),
    *("command_line", "docstrings", "repository_links"),
]
exclude_patterns = ["_ext"]

myst_enable_extensions = ["dollarmath", "fieldlist"]
myst_heading_anchors = 3

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_type_aliases = {name: name for name in ALIASES}
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
# A docstring quotes names in single backticks, as Markdown does.
default_role = "code"

nitpicky = True
nitpick_ignore_regex = [
    # A type in a signature links to its entry where it has one.
    (r"py:(class|obj|data)", r".*")
]

# `--option` stays what one types.
smartquotes = False
maximum_signature_line_length = 90

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"LIRS-WCT {release}"
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
