"""Records: what they refuse, and what slicing, resampling and converting keep."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.errors import InputError
from hitchid.logs.record import Record, resampled
from hitchid.logs.resampling import GRID_TOLERANCE

EPS = np.finfo(np.float64).eps
with_fixture = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
lengths = st.integers(-(10**6), 10**6).map(lambda k: k / 1000)


def fresh(**changes):
    given = {
        "name": "test",
        "step_s": 0.01,
        "signals": {"displacement": np.arange(5.0), "lifting_command": np.ones(5)},
        "units": {"displacement": "mm", "lifting_command": "A"},
    }
    return Record(**{**given, **changes})


def of(displacement=None, command=None):
    given = {"displacement": displacement, "lifting_command": command}
    return {"signals": {role: np.array(samples) for role, samples in given.items() if samples is not None}}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (of(command=[1.0, 1.0]), ["displacement", "lifting_command"]),
        (of([1.0, 1.0]), ["command", "none"]),
        ({"step_s": 0.0}, ["sampling time", "0.0 s"]),
        ({"step_s": -0.01}, ["sampling time", "-0.01 s"]),
        ({"step_s": float("nan")}, ["sampling time", "nan"]),
        (of(np.ones(5), np.ones(4)), ["'lifting_command'", "(4,)", "(5,)"]),
        (of([0, 1, np.nan], np.ones(3)), ["'displacement'", "nan", "sample 2"]),
        (of(np.arange(3.0), [1, -np.inf, 1]), ["'lifting_command'", "-inf", "sample 1"]),
    ],
)
def test_a_record_refuses_what_later_rooms_could_not_use(changes, words):
    with pytest.raises(InputError, match="record 'test'") as caught:
        fresh(**changes)
    assert all(word in str(caught.value) for word in words)


def test_samples_are_the_records_own_and_cannot_be_written():
    mine = np.arange(5.0)
    record = fresh(**of(mine, np.ones(5)))
    mine[0] = 99.0
    assert record.displacement[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record.displacement[0] = 99.0
    with pytest.raises(TypeError):
        record.signals["displacement"] = mine  # type: ignore[index]


def test_a_record_has_the_modes_it_has_commands_for():
    record = fresh()
    assert record.directions == ("lifting",)
    np.testing.assert_array_equal(record.command("lifting"), np.ones(5))
    with pytest.raises(InputError, match=r"'test'.*no lowering command.*displacement, lifting_command"):
        record.command("lowering")


@with_fixture
@given(st.integers(0, 30), st.integers(0, 30), st.integers(0, 30), st.integers(0, 30))
def test_a_slice_of_a_slice_is_a_slice(make_record, a, b, c, d):
    whole = make_record(np.arange(30.0) ** 2, np.arange(30.0))
    start, stop = sorted((a, b))
    inner, outer = sorted((min(c, stop - start), min(d, stop - start)))
    twice, once = whole.slice(start, stop).slice(inner, outer), whole.slice(start + inner, start + outer)
    for role in whole.signals:
        np.testing.assert_array_equal(twice.signals[role], once.signals[role])
    assert (twice.name, twice.kind, twice.step_s) == (once.name, once.kind, once.step_s)
    assert twice.start_s == pytest.approx(once.start_s, abs=4 * EPS)  # two rounded sums below one second


def test_a_slice_keeps_time_and_takes_its_name(make_record):
    whole = make_record(np.arange(50.0), np.ones(50))
    part = whole.slice(20, 45, name="part", kind="cycle")
    np.testing.assert_allclose(part.time_s, whole.time_s[20:45], rtol=4 * EPS)
    assert (part.name, part.kind, len(part)) == ("part", "cycle", 25)


@given(arrays(np.float64, 40, elements=lengths), st.sampled_from(["mm", "cm", "m", "in"]))
def test_a_fingerprint_survives_another_name_unit_and_command(moved, unit):
    record = fresh(**of(moved, np.ones(40)))
    other = Record(
        name="copy",
        step_s=0.01,
        signals={"displacement": moved, "lowering_command": np.zeros(40)},
        units={"displacement": "mm", "lowering_command": "V"},
        start_s=7.0,
    )
    assert other.convert({"displacement": unit}).fingerprint == record.fingerprint


@given(arrays(np.float64, 40, elements=st.floats(-4, 4)), st.integers(3, 39), st.floats(1e-3, 1))
def test_a_test_that_moved_otherwise_is_another_test(moved, at, by):
    moved[:3] = 0.0, 10.0, -10.0  # its range, so that the change is at least 5·10⁻⁵ of it
    changed = moved.copy()
    changed[at] += by
    assert len({fingerprint(way) for way in (moved, changed, 2 * moved, moved[:-1])}) == 4


def fingerprint(moved):
    return fresh(**of(moved, np.ones(moved.size))).fingerprint


@given(arrays(np.float64, 20, elements=lengths), st.sampled_from(["mm", "cm", "m", "in"]))
def test_converting_there_and_back_returns_the_samples(moved, unit):
    record = fresh(**of(moved, np.ones(20)))
    there = record.convert({"displacement": unit, "lowering_command": "V"})
    assert dict(there.units) == {"displacement": unit, "lifting_command": "A"}
    np.testing.assert_array_equal(there.command("lifting"), record.command("lifting"))
    # Two factors and two products, each rounded once.
    np.testing.assert_allclose(there.convert({"displacement": "mm"}).displacement, moved, rtol=4 * EPS)


def test_a_unit_of_another_dimension_is_refused_with_record_and_role():
    with pytest.raises(InputError, match=r"'test', displacement: 'mm'.*'bar'"):
        fresh().convert({"displacement": "bar"})


@given(
    offset=lengths,
    slope=lengths,
    had=st.lists(st.floats(0.001, 0.1), min_size=1, max_size=50),
    count=st.integers(1, 60),
)
def test_resampling_keeps_a_straight_line(offset, slope, had, count):
    had_s = np.cumsum([0.0, *had])
    wanted_s = np.linspace(0, had_s[-1], count)
    taken = resampled({"displacement": offset + slope * had_s}, had_s, wanted_s)["displacement"]
    # Values up to 10³·5 s are rounded to eps, and the slope between two of them 1 ms apart magnifies that
    # by at most the interval's own length again.
    size = np.abs(offset) + np.abs(slope) * had_s[-1]
    np.testing.assert_allclose(taken, offset + slope * wanted_s, rtol=0, atol=16 * EPS * size)


@given(
    had=st.lists(st.floats(0.001, 0.1), min_size=1, max_size=50),
    wanted=st.lists(st.floats(-0.1, 5.5), min_size=1, max_size=50),
)
def test_a_command_is_in_force_from_its_stamp_on(had, wanted):
    had_s, wanted_s = np.cumsum([0.0, *had]), np.sort(wanted)
    slack = GRID_TOLERANCE * np.median(np.diff(had_s))
    taken = resampled({"lifting_command": had_s}, had_s, wanted_s)["lifting_command"]
    assert np.all(np.diff(taken) >= 0)
    for at, stamp in zip(wanted_s, taken, strict=True):
        # The command's value is its own stamp: that of the last one at or before the instant.
        assert stamp >= had_s[had_s <= at].max(initial=0.0)
        assert stamp <= max(0.0, at + slack)
    same = resampled({"lifting_command": had_s}, had_s, had_s * (1 - 1e-12))
    assert np.all(same["lifting_command"] >= had_s)  # no stamp is missed by rounding


@given(arrays(np.float64, 30, elements=lengths), st.floats(0.001, 0.1))
def test_resampling_invents_no_level_of_command(command, step_s):
    record = fresh(**of(np.arange(30.0), command)).resample(step_s)
    assert set(record.command("lifting")) <= set(command)
    assert record.command("lifting")[0] == command[0]


@given(st.integers(2, 200), st.floats(0.001, 0.1), st.floats(0.001, 0.1))
def test_resampling_leaves_less_than_a_step_out(samples, had, wanted):
    record = fresh(**of(np.arange(float(samples)), np.ones(samples)), step_s=had)
    fine = record.resample(wanted)
    assert fine.step_s == wanted
    left = (samples - 1) * had - (len(fine) - 1) * wanted
    assert -1e-10 <= left <= wanted * (1 + 1e-10)  # the last sample counts where it is met but for rounding
    assert [notice.code for notice in fine.notices] == ["step-changed"]
    np.testing.assert_allclose(
        fine.displacement * had, np.minimum(wanted * np.arange(len(fine)), (samples - 1) * had), atol=1e-10
    )


def test_resampling_to_its_own_clock_changes_no_sample(make_record):
    record = make_record(np.random.default_rng(0).normal(size=99), np.arange(99.0))
    same = record.resample(0.01)
    for role in record.signals:
        np.testing.assert_array_equal(same.signals[role], record.signals[role])
