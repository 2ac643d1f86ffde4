"""Checks as JUnit XML: well-formed whatever they say, counted right, the same bytes each time."""

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from hitchid.report import Document, render
from hitchid.report.verdict import check_line
from hitchid.validation import Check

KEPT = Check("lifting", "lifting: free run, RMSE", "at most 0.5 mm", "0.065 mm", True)
BROKEN = Check("lowering", "lowering: free run, R²", "at least 0.99", "0.98", False)

anything = st.text(
    st.characters(exclude_categories=()) | st.sampled_from("\x00\t\n\r\x1b\ud800\ufffe\uffff<&\"'")
)
checks = st.lists(st.builds(Check, anything, anything, anything, anything, st.booleans()))


def written(*given):
    return render(Document("Validation", checks=given), "junit")


def parsed(*given):
    return ElementTree.fromstring(written(*given))  # noqa: S314


def test_a_kept_and_a_broken_limit_become_two_cases():
    root = parsed(KEPT, BROKEN)
    assert root.tag == "testsuites"
    (suite,) = root
    assert suite.tag == "testsuite"
    for counted in (root, suite):
        assert {key: counted.get(key) for key in ("name", "tests", "failures", "errors")} == {
            "name": "hitchid",
            "tests": "2",
            "failures": "1",
            "errors": "0",
        }
    kept, broken = suite
    assert kept.attrib == {"classname": "hitchid.lifting", "name": KEPT.name}
    assert len(kept) == 0
    assert broken.attrib == {"classname": "hitchid.lowering", "name": BROKEN.name}
    (failure,) = broken
    assert failure.attrib == {"message": "0.98, required at least 0.99", "type": "limit"}
    assert failure.text == "fail  lowering: free run, R² 0.98, required at least 0.99" == check_line(BROKEN)


def test_what_xml_does_not_admit_is_escaped():
    check = Check("lifting", *["a\x00\x1b\ud800\ufffe\uffffb <&>\"' é\t\n\U0001f600"] * 3, False)
    admitted = r"a\u0000\u001b\ud800\ufffe\uffffb <&>" + "\"' é\t\n\U0001f600"
    case = parsed(check)[0][0]
    assert case.get("name") == admitted
    assert case[0].get("message") == f"{admitted}, required {admitted}"


@given(checks=checks)
def test_any_text_gives_a_file_that_reads_back(checks):
    root = parsed(*checks)
    failures = [case for case in root[0] if case.find("failure") is not None]
    assert [len(root[0]), len(failures)] == [int(root.get(key, "")) for key in ("tests", "failures")]
    assert [case.find("failure") is None for case in root[0]] == [check.passed for check in checks]


def test_equal_checks_give_equal_bytes_in_utf_8():
    content = written(KEPT, BROKEN)
    assert content == written(KEPT, BROKEN)
    assert content.startswith(b'<?xml version="1.0" encoding="UTF-8"?>\n')
    assert "R²".encode() in content
    assert content.endswith(b"</testsuites>\n")
