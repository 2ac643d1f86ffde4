"""The protocol of a renderer."""

from abc import ABC, abstractmethod
from typing import ClassVar

from hitchid.report.document import Document


class Renderer(ABC):
    """A form that a document is written in.

    Another package adds one by an entry point in the group `hitchid.renderers` whose value is an instance.

    Attributes:
        name: of the renderer, unique among all.
        suffix: of its files, with the dot.
    """

    name: ClassVar[str]
    suffix: ClassVar[str]

    @abstractmethod
    def render(self, document: Document) -> bytes:
        """Return a document as the content of a file; equal documents give equal bytes.

        Raises:
            InputError: a package that the renderer requires is not installed.
        """
