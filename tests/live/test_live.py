"""A model in a loop: every line is answered, whatever it says, and never with NaN."""

import json
import math

import jax
import jax.monitoring
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handmade
from handmade import DEAD_ZONES, GAINS, STEP_S
from hitchid.errors import InputError
from hitchid.live.live import AGREEING, FIELDS, KEPT_S, MAX_GAP_SAMPLES, Live
from hitchid.logs.record import LIFTING
from truth import levels

MODEL = handmade.hitch(compensated=True)
START = 100.0
LIFT = 0.5
TRAVEL = STEP_S * GAINS[LIFTING] * (LIFT - DEAD_ZONES[LIFTING])


def sample(time_s=None, lifting=None, lowering=None, displacement=None, **others):
    """Return one line, without what is None."""
    values = {
        "time_s": time_s,
        "lifting_command": lifting,
        "lowering_command": lowering,
        "displacement": displacement,
        **others,
    }
    return json.dumps({name: value for name, value in values.items() if value is not None})


def full(time_s, **others):
    """Return one line with everything in it."""
    return sample(time_s, **{"lifting": LIFT, "lowering": 0.0, "displacement": START, **others})


def said(answer, word):
    return any(word in flag for flag in answer.flags)


def pair(**options):
    """Return two models before any sample."""
    return Live(MODEL, **options), Live(MODEL, **options)


def test_it_waits_for_a_displacement_and_starts_there():
    live, other = pair()
    waiting = live.process(sample(0.0, LIFT, 0.0))
    assert (waiting.displacement, waiting.mode) == (None, "standing")
    assert waiting.flags == ("waiting for an initial displacement",)
    begun = live.process(full(0.01))
    assert (begun.mode, begun.flags) == ("lifting", ())
    assert begun == other.process(full(0.01))


def test_with_an_initial_displacement_it_starts_at_once():
    answer = Live(MODEL, initial=START).process(sample(0.0, LIFT, 0.0))
    assert answer.displacement == pytest.approx(START + TRAVEL, rel=1e-12)
    assert (answer.mode, answer.flags) == ("lifting", ())
    for initial in (math.nan, math.inf):
        with pytest.raises(InputError, match=r"^displacement: .*finite"):
            Live(MODEL, initial=initial)


def test_a_missing_command_keeps_the_last_one():
    live, other = pair(initial=START)
    assert live.process(sample(0.0, LIFT, 0.0)) == other.process(sample(0.0, LIFT, 0.0))
    answer, expected = live.process(sample(0.01)), other.process(sample(0.01, LIFT, 0.0))
    assert answer.displacement == expected.displacement
    assert answer.flags == tuple(
        f"{mode}_command is missing: the last value is held" for mode in ("lifting", "lowering")
    )
    assert expected.flags == ()


def test_a_missing_displacement_is_coasted_over_with_a_flag():
    live = Live(MODEL, initial=START)
    assert not said(live.process(sample(0.0, LIFT, 0.0)), "no displacement was measured")
    measured = live.process(full(0.01))
    assert not said(measured, "no displacement was measured")
    coasted = live.process(sample(0.02, LIFT, 0.0))
    assert said(coasted, "no displacement was measured")
    # The benchmark's travel, and the step of the predicted error, a few of its σ.
    assert coasted.displacement == pytest.approx(measured.displacement + TRAVEL, abs=10 * handmade.ERROR_STEP)


@pytest.mark.parametrize("missed", [1, 7])
def test_samples_that_come_late_are_made_up_for(missed):
    live, other = pair()
    assert live.process(full(0.0)) == other.process(full(0.0))
    for _ in range(missed):
        other.process(sample())
    again = STEP_S * (missed + 1)
    late, expected = (own.process(full(again, displacement=101.0)) for own in (live, other))
    assert late.displacement == expected.displacement
    assert late.flags == (f"late: {missed} samples are missing before {again:g} s",)
    assert expected.flags == ()


@given(st.lists(st.floats(-1.4, 1.4), min_size=2, max_size=30), st.sampled_from([0.004, STEP_S, 0.017]))
def test_every_sample_counts_for_its_nearest_time(jitter, every_s):
    live, stamps = Live(MODEL), np.sort(every_s * (np.arange(len(jitter)) + np.array(jitter)))
    stamps = np.concatenate([stamps[:1], stamps[1:][np.diff(stamps) > 0]])
    for stamp in stamps:
        answer = live.process(sample(float(stamp), LIFT, 0.0, START if stamp == stamps[0] else None))
        assert not said(answer, "out of order")
        assert abs(answer.time_s - stamp - STEP_S) <= 0.5 * STEP_S + 1e-8
    steps = round((answer.time_s - stamps[0]) / STEP_S)
    alone = Live(MODEL)
    alone.process(full(0.0))
    for _ in range(steps - 1):
        expected = alone.process(sample(lifting=LIFT, lowering=0.0)).displacement
    assert steps == 1 or answer.displacement == pytest.approx(expected, rel=1e-12)


def test_of_two_samples_for_one_time_the_later_counts():
    live, other = pair()
    assert live.process(full(0.0)) == other.process(full(0.0))
    live.process(sample(0.006, LIFT, 0.0, 102.0))
    answer = live.process(sample(0.014, 0.0, LIFT))
    assert said(answer, "early: the samples at 0.006 s and 0.014 s are in the same sampling step")
    expected = other.process(sample(0.01, 0.0, LIFT, 102.0))
    assert (answer.displacement, answer.mode) == (expected.displacement, expected.mode)


def test_lines_without_a_time_use_up_none():
    live, other = pair()
    for k in range(20):
        live.process("")
        live.process("nonsense")
        answer, expected = live.process(full(STEP_S * k)), other.process(full(STEP_S * k))
        assert answer == expected or not k


def test_what_leaves_the_tests_is_told():
    covered = handmade.envelope(command=(0.05, 0.4), displacement=(50.0, 150.0))
    live = Live(handmade.hitch("integrator", covered=covered))
    assert live.process(full(0.0)).flags == ()
    zone = DEAD_ZONES[LIFTING]
    assert live.process(full(0.01, lifting=zone + 0.39, displacement=149.0)).flags == ()
    for lifting, displacement in ((zone + 0.41, 100.0), (zone + 0.04, 100.0)):
        (flag,) = live.process(full(None, lifting=lifting, displacement=displacement)).flags
        ends = f"{zone + 0.05:.4g} to {zone + 0.4:.4g} A"
        assert flag == f"outside: lifting_command {lifting:g}; the identified range is {ends}"
    (flag,) = live.process(full(None, displacement=151.0)).flags
    assert flag.startswith("outside: displacement 151; the identified range is 50 to 150 mm")


def test_everything_is_compiled_before_the_first_sample():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name) if "compile" in name or "trace" in name else None
    )
    try:
        live = Live(handmade.hitch("integrator-first-order", compensated=True, free_run=True))
        assert compiled
        compiled.clear()
        live.process(full(0.0))
        assert compiled == []
    finally:
        jax.monitoring.clear_event_listeners()


@pytest.mark.parametrize("early", [0.02, 0.0, -50.0])
def test_a_sample_out_of_order_is_not_taken_in(early):
    live, other = pair()
    for k in range(3):
        last = other.process(full(STEP_S * k))
        assert live.process(full(STEP_S * k)) == last
    refused = live.process(full(early, lifting=0.0, displacement=50.0))
    assert refused[:3] == last[:3]
    assert [flag.partition(":")[0] for flag in refused.flags] == ["out of order"]
    assert live.process(full(0.03)) == other.process(full(0.03))


def test_stamps_since_1970_are_told_to_their_decimals():
    live = Live(MODEL)
    live.process(full(1.7e9))
    assert live.process(full(1.7e9 + 0.05)).flags == ("late: 4 samples are missing before 1700000000.05 s",)


# --- clocks -------------------------------------------------------------------------------------------------


def running(samples=40):
    """Return a model that has had so many samples, and one that had the same."""
    live, other = pair()
    assert_alike(live, other, range(samples))
    return live, other


def assert_alike(live, other, numbers):
    """Check that two models answer samples alike."""
    for number in numbers:
        assert live.process(full(STEP_S * number)) == other.process(full(STEP_S * number))


@pytest.mark.parametrize("ahead_s", [99.0, 9.0, 1.2, 0.5, 0.03, 1e15, 1e308, -99.0, -1.2, -0.05, -1e300])
@pytest.mark.parametrize("measured", [START, 1e6])
def test_one_bad_stamp_costs_one_sample(ahead_s, measured):
    live, other = running()
    flags = live.process(full(0.4 + ahead_s, lifting=0.9, displacement=measured)).flags
    assert flags[0].startswith(("doubtful", "late", "out of order"))
    live.process(full(0.41))
    other.process(full(0.41))
    assert_alike(live, other, range(42, 50))


def test_a_sample_that_overtook_another_is_left_out():
    live, other = running(3)
    assert said(live.process(full(0.05, lifting=0.0)), "late: 2 samples are missing before 0.05 s")
    answer = live.process(full(0.03))
    assert answer.flags == ("out of order: 0.03 s follows 0.05 s, which is left out",)
    assert answer[:3] == other.process(full(0.03))[:3]


@pytest.mark.parametrize("bad", [2, AGREEING - 1])
def test_bad_stamps_that_agree_cost_themselves_alone(bad):
    live, other = running()
    for number in range(bad):
        live.process(full(99.0 + STEP_S * number))
    live.process(full(STEP_S * (40 + bad)))
    other.process(full(STEP_S * (40 + bad)))
    assert_alike(live, other, range(41 + bad, 50))


@pytest.mark.parametrize(("line", "count"), [("noise", 1), ("noise", 2000), (None, 50), (None, 200)])
def test_lines_without_a_stamp_do_not_drive_the_clock_away(line, count):
    """Neither what is no sample nor samples without one."""
    live, _ = running()
    for _ in range(count):
        live.process(line or sample(lifting=LIFT, lowering=0.0, displacement=START))
    answers = [live.process(full(STEP_S * number)) for number in range(40, 45)]
    assert not any(said(answer, "out of order") for answer in answers)
    assert answers[-1].time_s == pytest.approx(0.45)
    if line is None:
        assert [answer.time_s for answer in answers] == pytest.approx(STEP_S * np.arange(41, 46))
        assert said(answers[0], "the clock was set back from") == (STEP_S * count > KEPT_S)
        assert answers[-1].flags == ()


@pytest.mark.parametrize("jump_s", [99.0, 1.5, -0.7, -1.1, -99.0])
@pytest.mark.parametrize("bad", [0, 1])
def test_a_clock_that_jumps_is_followed_within_a_second(jump_s, bad):
    """Also where every other stamp is a bad one of its own."""
    live, _ = running()
    for number in range(round(1.0 / STEP_S)):
        stamp = 0.4 + jump_s + STEP_S * number
        for _ in range(bad):
            live.process(full(1e6 * (number + 1)))
        answer = live.process(full(stamp))
    assert (answer.flags, answer.mode) == ((), "lifting")
    assert answer.time_s == pytest.approx(stamp + STEP_S)


@pytest.mark.parametrize("first_s", [0.0, 1e9, 1e308, -1e5])
@pytest.mark.parametrize("initial", [None, START])
def test_a_stale_first_stamp_costs_two_samples(first_s, initial):
    live, measured = Live(MODEL, initial=initial), None if initial else START
    live.process(full(first_s, displacement=measured))
    answers = [live.process(full(500 + STEP_S * number, displacement=measured)) for number in range(4)]
    assert [bool(answer.flags) for answer in answers] == [True, True, False, False]
    assert answers[-1].time_s == pytest.approx(500 + 4 * STEP_S)
    assert answers[-1].displacement is not None


@pytest.mark.parametrize("every_s", [0.02, 1.0, 2.0, 20.0])
@pytest.mark.parametrize("late_s", [0.0, 99.0])
def test_a_slow_stream_is_late_by_its_own_interval_alone(every_s, late_s):
    """One bad stamp in it costs itself."""
    live = Live(MODEL)
    for number in range(3):
        live.process(full(every_s * number))
    if late_s:
        assert said(live.process(full(every_s * 3 + late_s)), "doubtful")
    for number in range(3, 12):
        answer = live.process(full(every_s * number))
        assert (answer.flags, answer.time_s) == ((), pytest.approx(every_s * number + STEP_S))
    late = live.process(full(every_s * 13))
    assert said(late, "late" if 2 * every_s <= KEPT_S else "doubtful")


def test_a_clock_set_far_back_starts_anew():
    live, other = running()[0], Live(MODEL)
    for number in range(AGREEING):
        begun = live.process(full(-5000.0 + STEP_S * number, displacement=50.0))
    assert said(begun, "the clock was set back from 0.4 s to -4999.96 s")
    assert begun.displacement == other.process(full(0.0, displacement=50.0)).displacement


def test_after_too_long_a_gap_nothing_is_known_any_more():
    live = running()[0]
    for number in range(AGREEING):
        forgotten = live.process(sample(500.0 + STEP_S * number, LIFT, 0.0))
    assert (forgotten.displacement, forgotten.mode) == (None, "standing")
    assert said(forgotten, "late: ")
    assert said(forgotten, "waiting for an initial displacement")
    begun = live.process(full(500.0 + STEP_S * AGREEING, displacement=70.0))
    assert begun.displacement == Live(MODEL).process(full(0.0, displacement=70.0)).displacement


def test_over_the_longest_gap_the_model_goes_on():
    live = running(2)[0]
    for number in range(AGREEING):
        late = live.process(sample(STEP_S * (MAX_GAP_SAMPLES + number - AGREEING), LIFT, 0.0))
    assert said(late, "late: ")
    assert late.displacement is not None
    assert not said(late, "waiting for an initial displacement")


def test_both_valves_and_unknown_names_are_flags():
    live, other = pair()
    answer = live.process(full(0.0, pressure=3.0))
    assert answer.displacement == other.process(full(0.0)).displacement
    assert all(name in answer.flags[0] for name in ("'pressure'", *FIELDS))
    both = live.process(full(0.01, lowering=LIFT))
    assert (both.mode, both.flags) == (
        "lowering",
        ("both commands are active: the lowering command is used",),
    )
    assert live.process(full(0.02)).flags == ()


@pytest.mark.parametrize(
    ("line", "flag"),
    [
        *((line, "the line is not JSON") for line in ("", "{", "nonsense", "[" * 100_000)),
        ('{"displacement": ' + "9" * 5000 + "}", "the line is not JSON"),
        *((line, "expected an object") for line in ("[0.0, 0.5]", "1", '"text"', "null", "true", "NaN")),
    ],
    ids=range(11),
)
def test_what_is_no_sample_is_a_flag(line, flag):
    answer = Live(MODEL, initial=START).process(line)
    assert answer.displacement == START
    assert said(answer, flag)


@pytest.mark.parametrize("value", ["100", True, [100.0], {"mm": 100.0}])
def test_what_is_no_number_counts_as_missing_with_a_flag(value):
    live, other = running(1)
    answer, expected = live.process(full(0.01, displacement=value)), other.process(sample(0.01, LIFT, 0.0))
    assert answer.displacement == expected.displacement
    assert answer.flags == ("not a number: displacement", *expected.flags)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "null"])
@pytest.mark.parametrize("role", ["lifting_command", "displacement"])
def test_what_is_not_finite_counts_as_missing(role, text):
    live, other = running(1)
    content = json.loads(full(0.01))
    del content[role]
    expected = other.process(json.dumps(content))
    assert live.process(json.dumps(content)[:-1] + f', "{role}": {text}}}') == expected
    assert said(expected, "no displacement was measured" if role == "displacement" else "missing")


@pytest.mark.parametrize("size", [1e10, 1e40, 1.7e308])
def test_a_displacement_beyond_all_measure_is_none_to_start_from(size):
    live = Live(MODEL)
    assert live.process(full(0.0, displacement=size)).displacement is None
    assert live.process(full(0.01)).displacement == Live(MODEL).process(full(0.0)).displacement


numbers = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([0.3, 0.6, 100.0, 1e9, -1e9, 1e40, 1.7e308, -1.7e308, 10**400]),
)
values = st.one_of(numbers, st.booleans(), st.none(), st.text(max_size=5), st.lists(numbers, max_size=2))
names = st.sampled_from([*FIELDS, "pressure"])
lines = st.one_of(
    st.dictionaries(names, values, max_size=5).map(json.dumps),
    st.dictionaries(names, numbers, min_size=3, max_size=5).map(json.dumps),
    st.text(max_size=20),
)


@given(st.lists(lines, max_size=5), st.sampled_from([None, START]))
def test_whatever_comes_it_answers_with_numbers_or_nothing(stream, initial):
    live = Live(MODEL, initial=initial)
    for line in stream:
        answer = live.process(line)
        assert math.isfinite(answer.time_s)
        assert answer.displacement is None or math.isfinite(answer.displacement)
        assert answer.mode in ("lifting", "lowering", "standing")
        assert json.loads(answer.to_json(), parse_constant=pytest.fail) == {
            "time_s": answer.time_s,
            "displacement": answer.displacement,
            "mode": answer.mode,
            "flags": list(answer.flags),
        }
        assert len(answer.to_json().splitlines()) == 1


@pytest.fixture
def record(make_record):
    """Return a piston that stands, is lifted, and lowered, measured with noise once it moves."""
    rng = np.random.default_rng(3)
    up, down = levels(rng, 60, low=0.3), levels(rng, 60, low=0.3)
    lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
    noise = np.concatenate([np.zeros(6), 0.02 * rng.standard_normal(lifting.size - 6)])
    moved = 0.05 * np.concatenate([[0.0], np.cumsum(lifting - lowering)[:-1]])
    return make_record(START + moved + noise, lifting, lowering)


def displacements(live, record, *, measured):
    """Return the displacement answered to each sample, shape [N]."""
    columns = record.time_s, record.command("lifting"), record.command("lowering"), record.displacement
    samples = (sample(t, up, down, y if measured else None) for t, up, down, y in zip(*columns, strict=True))
    answers = list(map(live.process, samples))
    assert all(answer.flags == () for answer in answers)
    return np.array([answer.displacement for answer in answers])


def test_it_gives_what_simulate_and_predict_give(record):
    alone = displacements(Live(MODEL, initial=START), record, measured=False)
    # The same steps, compiled one by one and as a whole.
    np.testing.assert_allclose(alone[:-1], MODEL.simulate(record).displacement[1:], rtol=1e-12)
    corrected = displacements(Live(MODEL), record, measured=True)
    # Single precision of a network whose answers are a few σ = 0.02.
    tolerance = 1e-5 * handmade.ERROR_STEP
    np.testing.assert_allclose(corrected[:-1], MODEL.predict(record)[1:], atol=tolerance, rtol=0)


def test_a_rehearsal_changes_nothing():
    rng = np.random.default_rng(5)
    commands = np.column_stack([levels(rng, 60, low=0.0), levels(rng, 60, low=0.0)]).tolist()
    quiet, rehearsed = pair()
    rehearsed.rehearse()
    for number, (up, down) in enumerate(commands):
        # Every seventh line is out of order, every fifth late, every third without a displacement.
        time_s = STEP_S * (number - 3 * (number % 7 == 6) + 2 * (number % 5 == 4))
        line = sample(time_s, up, down, None if number % 3 == 2 else START)
        assert rehearsed.process(line) == quiet.process(line)
        rehearsed.rehearse()
