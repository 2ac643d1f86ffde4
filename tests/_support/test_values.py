"""Records that hold arrays are equal by content and copied whole; notices say where and how grave."""

import copy
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid._support.records import Notice, Severity, Value, same
from hitchid.errors import LogError
from hitchid.logs.unification import LeftOut


@dataclass(frozen=True, eq=False)
class Held(Value):
    """A record with everything that makes others hard to compare and to pickle."""

    name: str
    samples: np.ndarray
    signals: Mapping[str, np.ndarray]
    source: str = field(default="", compare=False)


def held(samples, **options):
    """Return a record of samples, held twice."""
    content = {"name": "a", "samples": samples, "signals": MappingProxyType({"y": samples}), **options}
    return Held(**content)


@given(samples=arrays(np.float64, st.integers(0, 5)), index=st.integers(0, 4))
def test_records_are_equal_if_every_sample_is(samples, index):
    one, other = held(samples), held(samples.copy(), source="elsewhere")
    assert one == other
    assert hash(one) == hash(other)
    assert one != held(samples, name="b")
    if samples.size:
        changed = samples.copy()
        changed[index % samples.size] = 1.0 if np.isnan(changed[index % samples.size]) else np.nan
        assert one != held(changed)
        assert one != held(samples, signals={"y": changed})
    assert one != held(samples, signals={"z": samples})
    assert one != held(np.append(samples, 0.0))
    assert one != "a"


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))]
)
def test_a_copy_is_equal(copied):
    one = held(np.array([1.0, np.nan]))
    again = copied(one)
    assert again == one
    assert again.source == one.source


@pytest.mark.parametrize(
    ("one", "other", "equal"),
    [
        (float("nan"), float("nan"), True),
        (1.0, 1, True),
        ((1, [2.0]), [1, (2.0,)], True),
        ((1,), (1, 2), False),
        ({"a": np.zeros(2)}, {"a": np.zeros(2)}, True),
        ({"a": 1}, {"b": 1}, False),
        (ValueError("x"), ValueError("x"), True),
        (ValueError("x"), ValueError("y"), False),
        (ValueError("x"), TypeError("x"), False),
        (np.zeros(2), np.zeros(3), False),
        (None, 0.0, False),
        ("a", "a", True),
    ],
)
def test_values_are_compared_by_content(one, other, equal):
    assert same(one, other) is equal
    assert same(other, one) is equal


def test_an_error_of_a_log_keeps_its_place_in_a_copy():
    error = LogError("a.csv", "broken", line=3, column="x")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) == "a.csv: line 3: column 'x': broken"
    assert (again.line, again.column, again.problem, again.reason) == (3, "x", "broken", error.reason)
    left_out = LeftOut("a", error)
    assert copy.deepcopy(left_out) == left_out
    assert left_out != LeftOut("a", LogError("a.csv", "cut short"))


def test_a_notice_is_a_place_a_sentence_and_a_severity():
    notice = Notice("clock-resampled", "the clock jitters")
    assert str(notice) == "the clock jitters"
    assert str(notice.at("log-1")) == "log-1: the clock jitters"
    assert str(notice.at("@2").at("log-1")) == "log-1: @2: the clock jitters"
    assert Notice("code", "sentence").severity is Severity.NOTE
    assert Notice("code", "sentence", "here", Severity.FAULT).at("there").severity is Severity.FAULT
