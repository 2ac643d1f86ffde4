"""Simulation without a measurement: against that of a log with the same commands, and closed forms."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handmade import DEAD_ZONES, NOISE, channel, envelope, hitch, hitch_of, with_bands
from hitchid import read
from hitchid.errors import InputError
from hitchid.logs.record import COMMAND, LIFTING, LOWERING, Record
from hitchid.model import Simulation, TravelLimits
from machine import moved
from truth import STEP_S, levels

SAMPLES, START = 240, 100.0
EXACT = 1e-9  # in mm, or relative
INTEGRATORS = hitch()
LOADED = hitch_of(*(channel(mode, shape=True, free_run=True) for mode in (LIFTING, LOWERING)))
MODELS = {
    "integrators": INTEGRATORS,
    "second order": hitch("integrator-second-order", dead_time_s=0.025),
    "both compensators": hitch("integrator-first-order", compensated=True, free_run=True),
    "one channel": hitch("integrator-first-order", modes=(LIFTING,), free_run=True),
    "load": LOADED,
    "drift": replace(INTEGRATORS, drift=-0.5),
}


def commands_of(seed=0, samples=SAMPLES):
    """Return lifting and lowering command, first one, then none, then the other, shape [N, 2]."""
    third = samples // 3
    both = np.zeros((samples, 2))
    for column, start in ((0, 0), (1, 2 * third)):
        both[start : start + third, column] = levels(np.random.default_rng(seed + column), third, low=0.3)
    return both


def logged(model, commands, *, step_s=STEP_S, start=START, pressure=None):
    """Return a log of commands whose displacement is measured at rest only, then is something else."""
    signals = {"displacement": np.full(len(commands), start)}
    first = np.flatnonzero(commands.any(axis=1))[0]
    signals["displacement"][first + 3 :] = -77.0  # also interpolated, only the initial value shows before
    for column, direction in enumerate((LIFTING, LOWERING)):
        if direction in model.channels:
            signals[COMMAND[direction]] = commands[:, column]
    if pressure is not None:
        signals["pressure"] = np.full(len(commands), pressure)
    units = {**model.units, "pressure": "bar"}
    return Record("log", step_s, signals, {role: units[role] for role in signals})


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("step_s", [STEP_S, 0.013])
def test_commands_alone_move_the_model_as_a_log_does(name, step_s):
    model, commands = MODELS[name], commands_of()
    commands = commands * [1, len(model.channels) - 1]
    load = 104.0 if name == "load" else None
    from_log = model.simulate(logged(model, commands, step_s=step_s, pressure=load))
    alone = model.simulate(commands, step_s=step_s, initial=START, load=load)
    np.testing.assert_allclose(alone.displacement, from_log.displacement, rtol=0, atol=EXACT)
    np.testing.assert_array_equal(alone.mode, from_log.mode)
    np.testing.assert_array_equal(alone.time_s, step_s * np.arange(SAMPLES))
    assert alone.flags == from_log.flags
    assert alone.unit == "mm"
    assert np.ptp(alone.displacement) > 1.0


@pytest.mark.parametrize("name", MODELS)
def test_several_starts_and_loads_are_each_simulated_as_if_alone(name):
    model, commands = MODELS[name], commands_of() * [1, len(MODELS[name].channels) - 1]
    initial = np.array([80.0, 100.0, 131.5])
    load = np.array([90.0, 100.0, 115.0]) if name == "load" else None
    together = model.simulate(commands, step_s=STEP_S, initial=initial, load=load)
    assert together.displacement.shape == together.mode.shape == together.out_of_range.shape == (3, SAMPLES)
    for number, start in enumerate(initial):
        own = None if load is None else load[number]
        alone = model.simulate(commands, step_s=STEP_S, initial=start, load=own)
        # Networks are in single precision, whose rounding differs between one and several.
        np.testing.assert_allclose(together.displacement[number], alone.displacement, rtol=EXACT)
        np.testing.assert_array_equal(together.mode[number], alone.mode)
        np.testing.assert_array_equal(together.out_of_range[number], alone.out_of_range)
    if name == "load":
        broadcast = model.simulate(commands, step_s=STEP_S, initial=initial[2], load=load)
        np.testing.assert_allclose(broadcast.displacement[2], alone.displacement, rtol=EXACT)
        assert np.abs(broadcast.displacement[0] - broadcast.displacement[2]).max() > 0.1


def test_what_is_given_counts_instead_of_what_a_record_shows():
    record = logged(LOADED, commands_of(), pressure=90.0)
    given_both = LOADED.simulate(record, initial=50.0, load=115.0)
    alone = LOADED.simulate(commands_of(), step_s=STEP_S, initial=50.0, load=115.0)
    np.testing.assert_allclose(given_both.displacement, alone.displacement, rtol=0, atol=EXACT)


@given(
    seed=st.integers(0, 1000),
    start=st.floats(-1e3, 1e3, allow_subnormal=False),
    samples=st.sampled_from([1, 2, 3, SAMPLES]),
)
def test_two_integrators_follow_their_closed_form(seed, start, samples):
    commands = commands_of(seed)[:samples]
    exact = moved(start, commands)
    simulated = INTEGRATORS.simulate(commands, step_s=STEP_S, initial=start)
    rounding = samples * np.finfo(float).eps * np.abs(exact).max()
    np.testing.assert_allclose(simulated.displacement, exact, rtol=0, atol=rounding)


FORMS = {
    "mapping": lambda c: {"lowering_command": c[:, 1], "lifting_command": list(c[:, 0])},
    "frame": lambda c: pd.DataFrame(c, columns=["lifting_command", "lowering_command"]),
    "frame with more": lambda c: pd.DataFrame(c, columns=list(COMMAND.values())).assign(note="x", time_s=0.0),
    "signed": lambda c: c[:, 0] - c[:, 1],
    "signed series": lambda c: pd.Series(c[:, 0] - c[:, 1]),
    "nested lists": lambda c: c.tolist(),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_commands_come_in_any_form(form):
    expected = INTEGRATORS.simulate(commands_of(), step_s=STEP_S, initial=START)
    simulated = INTEGRATORS.simulate(form(commands_of()), step_s=STEP_S, initial=START)
    np.testing.assert_array_equal(simulated.displacement, expected.displacement)


def test_one_channel_takes_its_command_alone_and_with_both_signs():
    model = hitch(modes=(LOWERING,))
    command = commands_of()[:, 1]
    down = model.simulate(command, step_s=STEP_S, initial=START)
    pair = model.simulate(np.stack([0 * command, command], axis=1), step_s=STEP_S, initial=START)
    np.testing.assert_array_equal(down.displacement, pair.displacement)
    up = model.simulate(-command, step_s=STEP_S, initial=START)
    np.testing.assert_allclose(up.displacement - START, START - down.displacement, rtol=0, atol=EXACT)


def test_the_mode_is_the_commands_and_hold_without_one():
    commands = np.zeros((60, 2))
    commands[10:20, 0], commands[30:40, 1] = 0.8, 0.8
    commands[50:55, 0] = 0.9 * DEAD_ZONES[LIFTING]
    run = INTEGRATORS.simulate(commands, step_s=STEP_S, initial=START)
    expected = np.full(60, "hold", dtype=run.mode.dtype)
    expected[10:20], expected[30:40] = LIFTING, LOWERING
    np.testing.assert_array_equal(run.mode, expected)
    # On a clock of half the step each state counts twice.
    fast = INTEGRATORS.simulate(np.repeat(commands, 2, axis=0), step_s=STEP_S / 2, initial=START)
    np.testing.assert_array_equal(fast.mode, np.repeat(expected, 2))
    delayed = hitch(dead_time_s=3 * STEP_S).simulate(commands, step_s=STEP_S, initial=START)
    np.testing.assert_array_equal(delayed.mode, np.roll(expected, 3))


def test_samples_outside_the_identified_range_are_flagged_and_marked():
    model = hitch(free_run=False, covered=envelope(command=(0.0, 0.3), displacement=(90.0, 1000.0)))
    commands = np.zeros((60, 2))
    commands[10:20, 0], commands[30:40, 0] = 0.6, 0.8
    run = model.simulate(commands, step_s=STEP_S, initial=START)
    np.testing.assert_array_equal(run.out_of_range, (np.arange(60) >= 30) & (np.arange(60) < 40))
    expected = "lifting: the command is outside the identified range, 0 to 0.3 A beyond the dead zone, in 10"
    assert run.flags == (f"{expected} of 60 samples",)
    both = model.simulate(commands, step_s=STEP_S, initial=[100.0, 80.0])
    command, displacement = both.flags
    assert command == f"{expected.removesuffix('10')}20 of 120 samples of 2 runs"
    low = both.displacement[1] < 90.0
    assert f"90 to 1000 mm, in {np.count_nonzero(low[10:])} of 120 samples" in displacement
    np.testing.assert_array_equal(both.out_of_range[1, 10:], (low | run.out_of_range)[10:])
    assert not INTEGRATORS.simulate(commands, step_s=STEP_S, initial=START).out_of_range.any()


def test_each_run_has_the_band_of_the_run_alone():
    model = with_bands(INTEGRATORS, LIFTING, LOWERING)
    commands = commands_of()
    together = model.simulate(commands, step_s=STEP_S, initial=[80.0, START]).band(0.8)
    alone = model.simulate(commands, step_s=STEP_S, initial=START).band(0.8)
    from_log = model.simulate(logged(model, commands)).band(0.8)
    for rows, row, same in zip(together, alone, from_log, strict=True):
        np.testing.assert_allclose(rows[1], row, rtol=0, atol=EXACT)
        np.testing.assert_allclose(same, row, rtol=0, atol=EXACT)
    # The displacement moves the band but does not widen it; at the start it is that of the sensor's noise.
    widths = together.upper - together.lower
    np.testing.assert_allclose(widths[0], widths[1], rtol=0, atol=EXACT)
    assert widths[0, 0] == pytest.approx(2 * 1.2815515655446004 * NOISE, rel=1e-12)
    uncompensated = model.simulate(commands, step_s=STEP_S, initial=START, compensated=False)
    with pytest.raises(InputError, match="no bands for lifting and lowering"):
        uncompensated.band()


def test_the_table_has_a_row_per_sample_and_named_units():
    run = INTEGRATORS.simulate(commands_of(), step_s=STEP_S, initial=START)
    table = run.to_dataframe()
    assert list(table.columns) == ["time_s", "displacement_mm", "mode", "out_of_range"]
    np.testing.assert_array_equal(table["displacement_mm"], run.displacement)
    assert set(table["mode"]) == {LIFTING, LOWERING, "hold"}
    runs = INTEGRATORS.simulate(commands_of(), step_s=STEP_S, initial=[80.0, START])
    by_run = runs.to_dataframe().groupby("run")["displacement_mm"]
    np.testing.assert_array_equal(by_run.first(), [80.0, START])
    np.testing.assert_array_equal(by_run.get_group(1), run.displacement)


def test_a_simulation_is_taken_as_its_displacement():
    record = logged(INTEGRATORS, commands_of())
    run = INTEGRATORS.simulate(record)
    expected = record.displacement - run.displacement
    np.testing.assert_array_equal(record.displacement - run, expected)
    np.testing.assert_array_equal(run - record.displacement, -expected)
    assert np.sqrt(np.mean((record.displacement - run) ** 2)) > 0
    assert np.asarray(run, dtype=np.float32).dtype == np.float32
    assert not np.shares_memory(np.array(run), run.displacement)


def test_its_representation_is_short_and_tells_flags():
    model = hitch(free_run=False, covered=envelope(command=(0.0, 0.01), displacement=(99.0, 99.5)))
    run = model.simulate(commands_of(), step_s=STEP_S, initial=START)
    first, *flags = repr(run).splitlines()
    lowest, highest = run.displacement.min(), run.displacement.max()
    assert first == (f"Simulation: 240 samples, 0 to 2.39 s, displacement {lowest:.4g} to {highest:.4g} mm")
    assert " ".join(" ".join(flags).split()) == " ".join(run.flags)
    assert "3 runs of 240 samples" in repr(model.simulate(commands_of(), step_s=STEP_S, initial=[1, 2, 3]))


NO_COMMANDS = "commands: expected a record, a DataFrame, the path of a log, columns, or an array"
WRONG = {
    "no such log": ("log.csv", {}, "log.csv: there is no such file or folder"),
    "no shape": (0.5, {}, NO_COMMANDS),
    "three columns": (np.zeros((5, 3)), {}, r"commands: expected shape \[N, 2\].*got \(5, 3\)"),
    "three dimensions": (np.zeros((5, 2, 1)), {}, NO_COMMANDS),
    "ragged": ([[1.0], [1.0, 2.0]], {}, "commands: expected numbers"),
    "complex": (np.zeros(5, dtype=complex), {}, "commands: expected"),
    "no samples": (np.zeros((0, 2)), {}, "commands: expected at least one sample"),
    "not finite": ([0.0, np.nan, 0.0], {}, "'lifting_command' is nan at sample 1"),
    "infinite": ([[0.0, 0.0], [0.0, np.inf]], {}, "'lowering_command' is inf at sample 1"),
    "a column missing": (
        {"lifting_comand": [0.0], "lowering_command": [0.0]},
        {},
        "lifting_command is missing, found lifting_comand, lowering_command",
    ),
    "no column": ({}, {}, "commands: expected columns lifting_command and lowering_command"),
    "columns apart": (
        {"lifting_command": [0.0], "lowering_command": [0.0, 0.0]},
        {},
        r"shape \(1,\), expected \(2,\)|shape \(2,\), expected \(1,\)",
    ),
    "no sampling time": (np.zeros(5), {"step_s": None}, "step_s: expected the sampling time"),
    "a sampling time of zero": (np.zeros(5), {"step_s": 0.0}, "sampling time must be positive"),
    "no initial value": (np.zeros(5), {"initial": None}, "initial: expected the initial displacement, in mm"),
    "initial nan": (np.zeros(5), {"initial": np.nan}, "initial: expected one or several numbers"),
    "initial too large": (np.zeros(5), {"initial": [1.0, 1e9]}, "initial: expected .* within"),
    "initial text": (np.zeros(5), {"initial": "120"}, "initial: expected one or several numbers"),
    "initial table": (np.zeros(5), {"initial": np.zeros((2, 2))}, "initial: expected one or several numbers"),
    "initial empty": (np.zeros(5), {"initial": []}, "initial: expected one or several numbers"),
    "load without one": (np.zeros(5), {"load": 80.0}, "load: the model has no covariate"),
}


@pytest.mark.parametrize(("commands", "changed", "message"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_simulated_is_refused_by_name(commands, changed, message):
    with pytest.raises(InputError, match=message):
        INTEGRATORS.simulate(commands, **{"step_s": STEP_S, "initial": START, **changed})


MIXED = commands_of()
OF_OTHER_MODELS = {
    "load not given": (LOADED, MIXED, {}, "load: expected 'pressure' before motion, in bar"),
    "load not logged": (
        LOADED,
        logged(LOADED, MIXED),
        {"step_s": None, "initial": None},
        "no 'pressure'",
    ),
    "unequal numbers": (
        LOADED,
        MIXED,
        {"initial": [1, 2, 3], "load": [100.0, 110.0]},
        "initial and load: expected equal numbers of values, got 3 and 2",
    ),
    "no channel": (hitch(modes=(LIFTING,)), MIXED, {}, "no lowering channel"),
    "clock of a record": (INTEGRATORS, logged(INTEGRATORS, MIXED), {}, "step_s: a record has its own"),
}


@pytest.mark.parametrize(
    ("model", "commands", "changed", "message"), OF_OTHER_MODELS.values(), ids=OF_OTHER_MODELS
)
def test_commands_that_do_not_suit_the_model_are_refused(model, commands, changed, message):
    with pytest.raises(InputError, match=message):
        model.simulate(commands, **{"step_s": STEP_S, "initial": START, **changed})


def test_the_commands_of_a_measured_log_are_enough(data):
    (record,) = read(data("rig-a") / "cycle-01.csv").records
    for model in (INTEGRATORS, MODELS["both compensators"]):
        from_log = model.simulate(record)
        alone = model.simulate(record.signals, step_s=record.step_s, initial=from_log.displacement[0])
        assert isinstance(alone, Simulation)
        np.testing.assert_allclose(alone.displacement, from_log.displacement, rtol=0, atol=EXACT)
        assert np.ptp(alone.displacement) > 10.0


def test_models_of_like_structure_share_programs_of_free_runs(compilations):
    commands = levels(np.random.default_rng(3), 200, low=0.3)[:, None] * [1.0, 0.0]

    def model_with(dead_zone, end_stop, upper, drift):
        channels = [
            replace(
                channel(mode, "integrator-first-order", end_stop=end_stop),
                dead_zone=dead_zone,
                limits=TravelLimits(50.0, upper),
            )
            for mode in (LIFTING, LOWERING)
        ]
        return hitch_of(*channels, drift=drift)

    def displacement(model):
        run = model.simulate(commands, step_s=STEP_S, initial=[100.0, 101.0])
        return np.stack(
            [*run.displacement, model.simulate(commands, step_s=STEP_S, initial=100.0).displacement]
        )

    first, second = model_with(0.2, 130.0, 140.0, -0.1), model_with(0.25, 104.0, 103.0, -0.2)
    runs = [displacement(first)]
    with compilations() as compiled:
        runs.append(displacement(second))
    assert not [name for name in compiled if "backend_compile" in name]
    assert np.any(runs[0] != runs[1])
    assert np.max(runs[1]) == 103.0
