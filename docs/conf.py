"""The documentation site: `make docs` builds it from this folder, the docstrings and examples/gallery, warnings as errors."""

import os
import re
import sys
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.domains.python import PyXRefRole
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

import pysas

sys.path.insert(0, str(Path(__file__).parent))
from public_names import public_names  # noqa: E402  the folder is put on the path first

os.environ.setdefault("MPLBACKEND", "Agg")
sys.modules["pysas.simulation"] = pysas.simulation  # a name that users see, of a module that lies elsewhere: Sphinx imports it

project = "pysas"
author = copyright = "The pysas developers"
version = release = pysas.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["**/README.txt", "gallery/**/*.ipynb", "gallery/**/*.py"]
templates_path = ["_templates"]
nitpicky = True
# classes of other libraries, whose documentation is elsewhere
nitpick_ignore_regex = [("py:.*", r"(scipy|numpy|collections|matplotlib|xarray|distributed)\..*")]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

default_role = "py:name"

html_theme = "furo"
html_title = "pysas"
html_static_path = ["_static"]
html_css_files = ["pysas.css"]
html_show_sphinx = False
html_copy_source = False

# types stand in the docstrings, with shapes and units
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"plot_",
    "within_subsection_order": "FileNameSortKey",
    "doc_module": ("pysas",),
    "backreferences_dir": None,
    "reference_url": {"pysas": None},
    "abort_on_example_error": False,
    "show_signature": False,
    "download_all_examples": False,
    "min_reported_time": 0,
    "matplotlib_animations": False,
    "image_srcset": [],
    "remove_config_comments": True,
    "plot_gallery": os.environ.get("PYSAS_GALLERY", "True"),  # False: for a look at the pages alone
}

linkcheck_anchors = False
linkcheck_timeout = 15


def plain_text(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Docstrings are written for a terminal: a bar is a magnitude's there, and no substitution of reStructuredText."""
    for number, line in enumerate(lines):
        lines[number] = re.sub(r"`?docs/([\w-]+)\.md`?", r":doc:`/\1`", re.sub(r"(?<!\\)\|", r"\\|", line))


def pages_linked(app: Sphinx, page: str, text: list[str]) -> None:
    """Pages name each other as files of the tree, `docs/motion.md`: on the site that is a link."""
    text[0] = re.sub(r"`docs/([\w-]+)\.md`", r"[`docs/\1.md`](/\1.md)", text[0])


def plain_default(app: Sphinx, what: str, name: str, obj: object, options: object, text: str | None, back: object) -> object:
    """A default that is an object of ours shows as how it is made, not as what it prints."""
    return None if text is None else (re.sub(r"Frame\(x along heading[^)]*\)", "Frame()", text), back)


class Name(PyXRefRole):
    """What stands in single backticks in a docstring: a link to one of our public names, or an argument or a field."""

    def __init__(self) -> None:
        super().__init__(warn_dangling=False)


def named(app: Sphinx, env: BuildEnvironment, node: nodes.Element, text: nodes.TextElement) -> nodes.Node | None:
    """A name that is not of the module at hand: one of `pysas` itself, of another of its modules, or no link at all."""
    if node.get("reftype") != "name":
        return None
    domain, target = env.get_domain("py"), node["reftarget"]
    for found in (f"pysas.{target}", f"pysas.reference.{target}"):
        if found in domain.objects:
            return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", found, node, text)
    return text


def nothing_missing(app: Sphinx, env: BuildEnvironment) -> None:
    """Each public name is an entry of the reference; one that is missing fails a build in which warnings are errors."""
    found = set(env.get_domain("py").objects)
    for name in sorted(public_names() - found):
        logging.getLogger(__name__).warning("the reference lacks %s", name, type="pysas", subtype="missing")


def setup(app: Sphinx) -> None:
    app.connect("autodoc-process-docstring", plain_text, priority=1)
    app.connect("source-read", pages_linked)
    app.connect("autodoc-process-signature", plain_default)
    app.add_role_to_domain("py", "name", Name())
    app.connect("missing-reference", named)
    app.connect("env-check-consistency", nothing_missing)
