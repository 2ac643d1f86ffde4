"""Acceptance limits as JUnit XML, for build servers."""

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from hitchid.report.document import Document
from hitchid.report.renderers.renderer import Renderer
from hitchid.report.sections.acceptance import check_line
from hitchid.validation import Check

# Characters that are no Char of XML 1.0 (W3C Recommendation, section 2.2).
FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class JUnit(Renderer):
    """JUnit XML, one test case for each acceptance limit."""

    name, suffix = "junit", ".xml"

    def render(self, document: Document) -> bytes:
        """Return the acceptance limits of the document as test cases."""
        return junit_xml(document.checks)


def junit_xml(checks: Sequence[Check], *, name: str = "hitchid") -> bytes:
    """Return checks as JUnit XML, one test case per check; equal checks give equal bytes.

    Characters that XML 1.0 does not permit are omitted; the text of a failure is that of `check_line`.

    Args:
        checks: of `check_limits`.
        name: of the test suite; the class of a test case is `<name>.<direction>`.
    """
    failures = sum(not check.passed for check in checks)
    counts = {"name": _clean(name), "tests": str(len(checks)), "failures": str(failures), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {**counts, "skipped": "0"})
    for check in checks:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": _clean(f"{name}.{check.direction}"), "name": _clean(check.name)}
        )
        if not check.passed:
            message = {"message": _clean(f"{check.figure}, required {check.limit}"), "type": "limit"}
            ElementTree.SubElement(case, "failure", message).text = check_line(check)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _clean(text: str) -> str:
    return FORBIDDEN.sub("", text)
