"""The protocol of a renderer."""

from abc import ABC, abstractmethod
from typing import ClassVar

from hitchid.report.document import Document


class Renderer(ABC):
    """An output format of a document.

    Other packages register an instance as an entry point in the group `hitchid.renderers`.

    Attributes:
        name: of the renderer, unique among all.
        suffix: file suffix, with the dot.
        package: package that it requires and hitchid does not; empty for none.
        extra: the optional dependency of hitchid that installs it.
    """

    name: ClassVar[str]
    suffix: ClassVar[str]
    package: ClassVar[str] = ""
    extra: ClassVar[str] = ""

    @abstractmethod
    def render(self, document: Document) -> bytes:
        """Return a document as the content of a file; equal documents give equal bytes.

        Raises:
            InputError: a package that the renderer requires is not installed.
        """
