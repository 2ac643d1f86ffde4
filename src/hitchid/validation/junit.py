"""Checks as JUnit XML, which build servers read."""

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from hitchid.validation.acceptance import Check, line

# What is no Char of XML 1.0 (W3C Recommendation, section 2.2).
FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(checks: Sequence[Check], *, name: str = "hitchid", seconds: float | None = None) -> bytes:
    """Return checks as JUnit XML, one test case a check; equal checks give equal bytes.

    Characters that XML 1.0 does not admit are left out; the text of a failure is that of `line`.

    Args:
        checks: of `check_limits`.
        name: of the test suite; the class of a test case is `<name>.<mode>`.
        seconds: how long the checks took, s; None leaves the time out.
    """
    failures = sum(not check.passed for check in checks)
    counts = {"name": _clean(name), "tests": str(len(checks)), "failures": str(failures), "errors": "0"}
    if seconds is not None:
        counts["time"] = f"{seconds:.3f}"
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {**counts, "skipped": "0"})
    for check in checks:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": _clean(f"{name}.{check.mode}"), "name": _clean(check.name)}
        )
        if not check.passed:
            message = {"message": _clean(f"{check.found}, required {check.limit}"), "type": "limit"}
            ElementTree.SubElement(case, "failure", message).text = line(check)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _clean(text: str) -> str:
    return FORBIDDEN.sub("", text)
