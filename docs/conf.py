"""The documentation site: `make docs` turns the pages of this folder and the code's docstrings into build/docs.

Nothing is fetched, neither while it is built nor while it is read: no fonts, scripts or mathematics from elsewhere. The
search runs in the browser, also on pages opened as files.
"""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from myst_parser.parsers.sphinx_ import MystParser  # noqa: E402 after the path
from notebooks import as_markdown  # noqa: E402

from fabdesign.version import __version__  # noqa: E402

project = "fabdesign"
author = "The fabdesign developers"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
source_suffix = {".md": "markdown", ".ipynb": "notebook"}
root_doc = "index"
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # pages of docs/lab begin at any level

default_role = "literal"  # docstrings name code in single backticks
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "undoc-members": True}
python_use_unqualified_type_names = True


def write_excerpts(app, exception):
    """Write the text of pages beside the search page, which shows excerpts: as a file it fetches none."""
    if exception is None and app.builder.name == "html":
        texts = {name: app.env.get_doctree(name).astext() for name in app.env.found_docs if not name.startswith("lab/")}
        pages = {name + ".html": " ".join(text.split()) for name, text in texts.items()}
        (Path(app.outdir) / "_static" / "excerpts.js").write_text(
            f"const EXCERPTS = {json.dumps(pages)};", encoding="utf-8"
        )


def excerpts_on_search(app, pagename, templatename, context, doctree):
    """Load them there alone."""
    if pagename == "search":
        app.add_js_file("excerpts.js", priority=100)


def parameters_as_fields(app, what, name, obj, options, lines):
    """Show the sentences on parameters of a verb (`NAME: ...` at the beginning of a line) as a list."""
    names = [*getattr(obj, "__code__", parameters_as_fields.__code__).co_varnames]
    for k, line in enumerate(lines):
        word, colon, sentence = line.partition(": ")
        if what == "function" and colon and word in names and (not lines[k - 1] or lines[k - 1].startswith((":", " "))):
            lines[k] = f":param {word}: {sentence}"


class NotebookParser(MystParser):
    """Show a notebook as a page: its text, its code, and the outputs that are kept in it."""

    supported = ("notebook",)

    def parse(self, inputstring, document):
        super().parse(as_markdown(inputstring), document)


def leave_the_laboratory_out(app, env):
    """Pages of docs/lab are linked to, and neither in the navigation nor in the search."""
    for name in env.found_docs:
        if name.startswith("lab/"):
            env.metadata[name] |= {"nosearch": True, "orphan": True}


def setup(app):
    """Called by Sphinx."""
    app.add_source_parser(NotebookParser)
    app.connect("env-updated", leave_the_laboratory_out)
    app.connect("autodoc-process-docstring", parameters_as_fields)
    app.connect("build-finished", write_excerpts)
    app.connect("html-page-context", excerpts_on_search)


html_search_scorer = str(ROOT / "docs" / "search.js")
html_theme = "furo"
html_title = f"fabdesign {__version__}"
html_copy_source = False
html_show_sphinx = False
