"""Campaigns: one clock, one set of units, and which tests are held out."""

import fnmatch
from dataclasses import replace
from glob import escape

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hitchid.errors import InputError, LogError, SettingsError
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import CYCLE, LIFTING, LOWERING, Record

EPS = np.finfo(np.float64).eps
LIFTED = {"displacement": np.ones(9), "lifting_command": np.ones(9)}


def a_test(name, kind=LIFTING, *, samples=40, unit="mm", step_s=0.01, moved=None):
    """Return a record whose commands say its kind."""
    up, down = np.zeros(samples), np.zeros(samples)
    if kind in (LIFTING, CYCLE):
        up[5 : samples // 2] = 1.0
    if kind in (LOWERING, CYCLE):
        down[samples // 2 : -5] = 1.0
    moved = np.arange(float(samples)) if moved is None else moved
    signals = {"displacement": moved, "lifting_command": up, "lowering_command": down}
    units = {"displacement": unit, "lifting_command": "A", "lowering_command": "A"}
    return Record(name=name, step_s=step_s, signals=signals, units=units)


def names(records):
    return [record.name for record in records]


@pytest.mark.parametrize(
    ("tests", "held_out"), [(1, 0), (2, 1), (3, 1), (5, 1), (7, 1), (8, 2), (10, 2), (16, 3), (20, 4)]
)
def test_without_patterns_the_last_fifth_of_each_mode_is_held_out(tests, held_out):
    records = [a_test(f"{mode}-{n:02d}", mode) for mode in (LIFTING, LOWERING) for n in range(tests)]
    campaign = Campaign.of(records[::-1])
    for mode in (LIFTING, LOWERING):
        assert names(campaign.held_out(mode)) == [f"{mode}-{n:02d}" for n in range(tests - held_out, tests)]


@given(
    kinds=st.lists(st.sampled_from([LIFTING, LOWERING, CYCLE, "idle"]), min_size=1, max_size=12),
    patterns=st.none() | st.lists(st.sampled_from(["*", "0*", "*[13579]", "00"]), min_size=1, max_size=3),
)
def test_every_test_is_either_held_out_or_identified_from(kinds, patterns):
    records = [a_test(f"{number:02d}", kind) for number, kind in enumerate(kinds)]
    assume(all(fnmatch.filter(names(records), pattern) for pattern in patterns or ()))
    campaign = Campaign.of(records, test_patterns=patterns)
    assert [record.kind for record in campaign.records] == kinds
    for kind in set(kinds):
        held_out, rest = names(campaign.held_out(kind)), names(campaign.identification(kind))
        assert sorted(held_out + rest) == names(campaign.of_kind(kind))
        for pattern in patterns or ():
            assert set(fnmatch.filter(held_out, pattern)) == set(
                fnmatch.filter(names(campaign.of_kind(kind)), pattern)
            )


def test_a_name_with_brackets_is_matched_by_its_escaped_pattern():
    records = [a_test("run [1]"), a_test("run [2]"), a_test("run 1")]
    campaign = Campaign.of(records, test_patterns=[escape("run [1]")])
    assert names(campaign.held_out(LIFTING)) == ["run [1]"]
    with pytest.raises(InputError, match=r"'run \[2\]'.*3 tests"):
        Campaign.of(records, test_patterns=["run [2]"])


@pytest.mark.parametrize(
    ("records", "words"),
    [
        ([], ["at least one record"]),
        ([a_test("x"), a_test("x", LOWERING)], ["'x'", "names must differ"]),
        (
            [a_test("x"), Record("y", 0.01, LIFTED, {"displacement": "mm", "lifting_command": "A"})],
            ["'y'", "'x'", "lifting and lowering"],
        ),
        ([a_test("x", moved=np.full(40, 3.25))], ["x", "constant", "3.25 mm", "40 samples"]),
        ([a_test("x"), a_test("y", unit="bar")], ["'y'", "bar", "length"]),
    ],
)
def test_tests_that_do_not_fit_together_are_refused(records, words):
    with pytest.raises((InputError, LogError, SettingsError)) as caught:
        Campaign.of(records, strict=True)
    assert all(word in str(caught.value) for word in words)


def test_a_constant_sensor_without_command_is_no_fault():
    campaign = Campaign.of([a_test("rest", "idle", moved=np.full(40, 3.25)), a_test("x")])
    assert campaign.directions == (LIFTING,)


def test_all_records_come_in_the_unit_of_the_first_by_name():
    campaign = Campaign.of([a_test("b", unit="m"), a_test("a", unit="mm")])
    assert dict(campaign.units)["displacement"] == "mm"
    np.testing.assert_allclose(campaign.records[1].displacement, 1000 * np.arange(40), rtol=2 * EPS)


def test_records_of_another_rate_come_on_the_clock_of_the_most():
    line = np.arange(20) * 0.02
    campaign = Campaign.of([a_test("a"), a_test("b"), a_test("c", samples=20, step_s=0.02, moved=line)])
    assert campaign.step_s == 0.01
    last = campaign.records[2]
    assert len(last) == 39
    np.testing.assert_allclose(last.displacement, 0.01 * np.arange(39), atol=4 * EPS)
    assert [notice.code for notice in last.notices] == ["step-changed"]
    assert last.clock.logged_step_s == 0.02


@pytest.mark.parametrize(
    ("steps", "common"), [((0.01, 0.02), 0.01), ((0.001, 0.004), 0.001), ((4.0, 2.0), 2.0)]
)
def test_two_rates_meet_on_one_of_them(steps, common):
    records = [a_test(name, step_s=step) for name, step in zip("ab", steps, strict=True)]
    assert Campaign.of(records).step_s == common


def test_a_rate_close_to_the_common_one_is_adopted():
    odd = a_test("b", step_s=0.01 * (1 + 1e-6))
    campaign = Campaign.of([a_test("a"), odd, a_test("c")])
    assert campaign.records[1].step_s == 0.01
    np.testing.assert_array_equal(campaign.records[1].displacement, odd.displacement)
    assert campaign.records[1].notices == ()


def test_what_a_test_is_may_be_said_by_pattern():
    records = [a_test("warm-up-1"), a_test("x")]
    campaign = Campaign.of(records, kinds={"warm-up-*": CYCLE})
    assert [record.kind for record in campaign.records] == [CYCLE, LIFTING]
    with pytest.raises(InputError, match=r"'fish'.*lifting, lowering, ramp, cycle, idle"):
        Campaign.of(records, kinds={"x": "fish"})


def test_ramps_are_those_of_their_own_mode():
    rise = np.linspace(0, 1, 300)
    signals = {"displacement": rise, "lifting_command": rise, "lowering_command": 0 * rise}
    units = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    up = Record("up", 0.01, signals, units)
    down = Record("down", 0.01, {**signals, "lifting_command": 0 * rise, "lowering_command": rise}, units)
    campaign = Campaign.of([up, down, a_test("x")])
    assert names(campaign.ramps(LIFTING)) == ["up"]
    assert names(campaign.ramps(LOWERING)) == ["down"]


def a_cycle(name, repeats=1):
    """Return a record of strokes up and down by turns, with a rest of 1 s before each."""
    up = np.tile(np.repeat([0.0, 1.0, 0.0, 0.0], 100), repeats)
    down = np.tile(np.repeat([0.0, 0.0, 0.0, 1.0], 100), repeats)
    moved = np.cumsum(up - down) * 0.01
    return replace(
        a_test(name, samples=moved.size, moved=moved),
        signals={"displacement": moved, "lifting_command": up, "lowering_command": down},
    )


def test_cycles_are_cut_into_strokes_and_held_out_ones_stay_so():
    campaign = Campaign.of([a_cycle(f"duty[{n}]") for n in range(5)], test_patterns=[escape("duty[3]")])
    assert campaign.directions == ()
    cut = campaign.segmented({})
    for mode, stroke in ((LIFTING, "#001"), (LOWERING, "#002")):
        assert names(cut.of_kind(mode)) == [f"duty[{n}]{stroke}" for n in range(5)]
        assert names(cut.held_out(mode)) == [f"duty[3]{stroke}"]
    # Cutting moves no sample.
    for number, segment in enumerate(cut.of_kind(LOWERING)):
        start = round(segment.start_s / 0.01)
        whole = campaign.records[number].displacement
        np.testing.assert_array_equal(segment.displacement, whole[start : start + len(segment)])


def test_of_a_single_cycle_the_last_strokes_are_held_out():
    cut = Campaign.of([a_cycle("only", repeats=5)]).segmented({})
    assert names(cut.of_kind(LIFTING)) == [f"only#{n:03d}" for n in (1, 3, 5, 7, 9)]
    assert names(cut.held_out(LIFTING)) == ["only#009"]
    assert names(cut.held_out(LOWERING)) == ["only#010"]


@pytest.fixture
def numbered(make_record):
    """Return a campaign of four lifting tests."""
    command = np.where(np.arange(60) > 5, 0.5, 0.0)
    return Campaign.of([make_record(np.cumsum(command), command, name=f"up-{n}") for n in (1, 2, 3, 10)])


def test_a_campaign_is_a_sequence_of_its_records(numbered):
    assert len(numbered) == 4
    assert list(numbered) == list(numbered.records)
    assert numbered[0] is numbered["up-1"] is numbered[np.int64(0)] is numbered.records[0]
    assert numbered[-1].name == "up-10"
    assert "up-2" in numbered
    assert numbered[1] in numbered
    assert "up-4" not in numbered
    assert [record.name for record in reversed(numbered)] == ["up-10", "up-3", "up-2", "up-1"]


def test_slices_and_names_select_a_campaign(numbered):
    assert [record.name for record in numbered[1:3]] == ["up-2", "up-3"]
    assert numbered[:] == numbered
    chosen = numbered[["up-10", "up-1"]]
    assert [record.name for record in chosen] == ["up-1", "up-10"]
    assert isinstance(chosen, Campaign)
    # The last 20 % of the tests that are left, at least one, are held out.
    assert [record.name for record in chosen.held_out("lifting")] == ["up-10"]
    assert [record.name for record in numbered[:2].held_out("lifting")] == ["up-2"]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("up1", "none of the 4 tests is named 'up1'; did you mean 'up-1'"),
        ("zzz", "none of the 4 tests is named 'zzz'"),
        (4, "test index from -4 to 3, got 4"),
        (-5, "test index from -4 to 3, got -5"),
        (slice(7, 9), "no test is selected"),
        ([], "no test is selected"),
        (["up-1", "up-5"], "named 'up-5'"),
    ],
)
def test_a_test_that_is_not_there_is_refused_by_name(numbered, key, message):
    with pytest.raises(InputError, match=message):
        numbered[key]
