"""Settings of the documentation: Sphinx, Markdown, docstrings, equations as MathML, nothing from outside."""

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.domains.python import PyObject

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "hitchid"
version = release = installed("hitchid")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "command_line"]
exclude_patterns = ["extensions", "templates"]
templates_path = ["templates"]
highlight_language = "text"

myst_enable_extensions = ["amsmath", "attrs_block", "dollarmath"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

html_math_renderer = "mathml"
math_number_all = False
math_eqref_format = "({number})"

napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False  # docstrings contain shapes and units
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
# Types of other packages, whose documentation is not part of this one, and internal types.
INTERNAL = (
    "_support.checkpoints",
    "live.events._whole",
    "live.parameters.Annotated",
    "control.prediction.DrawnHitch",
    "control.prediction._State",
    "logs.dataframes.Frame",
    "estimation.search_problem",
    "identification.phase1.Fit",
    "model.inputs",
    "model.free_run.FreeRunInputs",
    "handover.responses.Banded",
    "model.simulation.SimulatedModel",
    "model.state.SpeedCompensatorState",
    "networks",
    "report.document",
    "model.trace",
    "structures.discrete_model",
    "uncertainty.scores",
    "uncertainty.influence",
)
nitpick_ignore_regex = [
    ("py:.*", r"(?!hitchid\.).*"),
    *(("py:.*", rf"hitchid\.{re.escape(name)}(\..*)?") for name in INTERNAL),
]
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
default_role = "code"

html_theme = "furo"
html_title = f"hitchid {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {"top_of_page_buttons": []}


def mend(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Correct what napoleon mistakes for a type.

    That is the sentence of a property up to its first colon, and the first of several names before one text.
    """
    if what == "property":
        for line in [line for line in lines if line.startswith(":type: ")]:
            lines.remove(line)
            lines[0] = f"{line.removeprefix(':type: ')}: {lines[0]}"
    for number, line in enumerate(lines):
        if line.startswith((":ivar ", ":param ")):
            field, colon, text = line[1:].partition(":")
            lines[number] = ":" + field.replace(", ", ",\u200b") + colon + text


def plain_defaults(
    app: Sphinx, what: str, name: str, obj: object, options: object, signature: str | None, result: str | None
) -> tuple[str, str | None] | None:
    """Replace defaults that are not Python, `<factory>` and `<Enum.MEMBER: value>`: they hide types."""
    if signature is None:
        return None
    return re.sub(r"<(\w+\.\w+): [^>]*>", r"\1", signature.replace("<factory>", "...")), result


def skip_fields(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out fields of a named tuple: the docstring of its class describes them."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> None:
    """Connect the handlers of docstrings."""
    app.connect("autodoc-process-docstring", mend, priority=600)
    app.connect("autodoc-process-signature", plain_defaults)
    app.connect("autodoc-skip-member", skip_fields)
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
