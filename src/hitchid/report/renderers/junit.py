"""Acceptance limits as JUnit XML, for build servers."""

from collections.abc import Sequence
from xml.etree import ElementTree

from hitchid._support.inert import xml_bytes
from hitchid.report.document import Document
from hitchid.report.renderers.renderer import Renderer
from hitchid.report.sections.acceptance import check_line
from hitchid.validation import Check


class JUnit(Renderer):
    """JUnit XML, one test case for each acceptance limit."""

    name, suffix = "junit", ".xml"

    def render(self, document: Document) -> bytes:
        """Return the acceptance limits of the document as test cases."""
        return junit_xml(document.checks)


def junit_xml(checks: Sequence[Check], *, name: str = "hitchid") -> bytes:
    """Return checks as JUnit XML, one test case per check; equal checks give equal bytes.

    Characters that XML 1.0 does not permit become escapes; the text of a failure is that of `check_line`.

    Args:
        checks: of `check_limits`.
        name: of the test suite; the class of a test case is `<name>.<direction>`.
    """
    failures = sum(not check.passed for check in checks)
    counts = {"name": name, "tests": str(len(checks)), "failures": str(failures), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {**counts, "skipped": "0"})
    for check in checks:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": f"{name}.{check.direction}", "name": check.name}
        )
        if not check.passed:
            message = {"message": f"{check.figure}, required {check.limit}", "type": "limit"}
            ElementTree.SubElement(case, "failure", message).text = check_line(check)
    return xml_bytes(root)
