"""The figures of a document as JSON."""

from hitchid._support.storage import canonical_json
from hitchid.report.document import Document
from hitchid.report.renderers.renderer import Renderer


class Json(Renderer):
    """JSON with sorted keys."""

    name, suffix = "json", ".json"

    def render(self, document: Document) -> bytes:
        """Return the content of `metrics.json` or `comparison.json`."""
        return canonical_json(document.data)
