"""Settings of Sphinx: `python -m sphinx -nW --keep-going -c docs . build/site` makes the site.

The source folder is the checkout, so that links between documents are the same on the site and in the repository.
"""

import importlib
import re
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert

from torchjoint import __version__

project = "torchjoint"
author = "the torchjoint authors"
copyright = f"2026, {author}"
release = version = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
extensions += ["sphinx.ext.autosummary", "sphinx_copybutton"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "docs/reference/*.rst",  # which autosummary writes
    "notebooks/*.ipynb",
    "benchmarks/README.md",
    "lab/README.md",
    "lab/studies/README.md",
    "lab/studies/before.md",
    "lab/studies/lidar.md",
    "CHANGELOG.md",
    "torchjoint/models/MODEL_CARD.md",
]
# Only so that these folders, which hold no page, are not searched.
exclude_patterns = [".*", "build", "configs", "dist", "out*", "tests", "torchjoint-demo*"]

html_theme = "furo"
html_title = f"torchjoint {release}"
html_static_path, html_css_files, html_js_files = ["static"], ["phone.css"], ["phone.js"]
html_extra_path = ["extra"]  # index.html, which leads to docs/index.html
templates_path = [str(Path(__file__).with_name("_templates"))]

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4  # the anchors that links between documents use
nb_execution_mode = "off"  # notebooks are committed with their outputs; CI runs them on their own

autosummary_imported_members = True
autosummary_ignore_module_all = False
# Names that torchjoint has of its modules have their page there.
modules = ("scene", "config", "datasets", "masks", "metrics", "ops", "recordings", "synthetic", "transforms")
names = [name for module in modules for name in importlib.import_module(f"torchjoint.{module}").__all__]
autosummary_context = {"elsewhere": [*modules, *names]}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_use_ivar = True  # attributes are lists: named tuples describe theirs a second time
python_use_unqualified_type_names = True

# Names of other packages would need their inventories, and so the network.
nitpick_ignore_regex = [(r"py:.*", r"(?!torchjoint\b).*")]


def is_there(name: str) -> bool:
    """Whether a dotted name is that of a module or of what can be reached from one by attributes."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def internal_name(app, environment, node, content):
    """A reference to something that exists, but is not public, becomes plain text; any other is a warning."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py":
        return None
    places = (node.get("py:module"), node.get("py:class"))
    module, cls = ("" if place is None else place for place in places)
    names = [target, f"{module}.{target}", f"{module}.{cls}.{target}"]
    return content if any(re.match(r"torchjoint\b", name) and is_there(name) for name in names) else None


def mathml(writer, node):
    """A formula as MathML, which browsers show by themselves: MathJax would need the network."""
    formula, is_block = node.astext(), isinstance(node, nodes.math_block)
    made = convert(formula, display="block" if is_block else "inline")
    if "\\" in made:  # a command that it does not know stays as it is
        raise ValueError(f"latex2mathml cannot convert {formula!r}")
    writer.body.append(f'<div style="overflow-x: auto">{made}</div>' if is_block else made)
    raise nodes.SkipNode


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
    app.connect("missing-reference", internal_name)
