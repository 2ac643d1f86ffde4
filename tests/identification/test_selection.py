"""The form is chosen by free run on operating points that were held out."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid._support.metrics import better_on_held_out_tests
from hitchid.errors import SettingsError
from hitchid.identification import AutoStructure, MultiStart, read_settings
from hitchid.identification.candidates import (
    Candidate,
    best_candidate,
    covariate_specs,
    goes_back,
    operating_point_folds,
)
from hitchid.identification.identify import DEFAULT_STRUCTURES
from hitchid.identification.selection import choose_spec, covariate_candidates
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.structures import Batch, CovariateEffects, ModelSpec, Scales, structure_named
from truth import levels

SAMPLES = 250
UNITS = {"x": "mm", "u": "A"}
PLAIN = ModelSpec(structure_named("integrator-second-order"))
CURVED, CURVED_VALUES = replace(PLAIN, valve_curve=True), [20.0, 15.0, 0.8, 0.05, 2.0, 0.6]
SEARCH = MultiStart(evaluations=60)
SCALES = Scales(*(jnp.asarray(scale) for scale in (1.0, 90.0, 40.0)))


def simulated(make_record, form, values, *, noise=0.02, tests=8, dead_zone=0.0, pauses=False):
    """Return tests, each around its own level, of a plant of a form with white noise.

    With pauses the command is zero in every second fifth of a test.
    """
    rng = np.random.default_rng(3)
    tops = np.linspace(0.3, 1.0, tests)
    shapes = [levels(rng, SAMPLES, low=0.6) for _ in tops]
    commands = [
        np.where(shape > 0, dead_zone + top * shape, 0.0) for top, shape in zip(tops, shapes, strict=True)
    ]
    if pauses:
        commands = [np.where(np.arange(SAMPLES) * 5 // SAMPLES % 2, 0.0, command) for command in commands]
    still = [make_record(np.full(SAMPLES, 80.0), command) for command in commands]
    batch = Batch.of(still, LIFTING, dead_zone=dead_zone, sign=1)
    travels = np.asarray(form.physical_model(jnp.asarray(values), SCALES).travel(batch))[:, :SAMPLES]
    moved = [80.0 + travel + noise * rng.standard_normal(SAMPLES) for travel in travels]
    records = [make_record(x, u) for x, u in zip(moved, commands, strict=True)]
    return Batch.of(records, LIFTING, dead_zone=dead_zone, sign=1)


def test_a_linear_plant_keeps_its_transfer_function(make_record):
    batch = simulated(make_record, PLAIN, [20.0, 15.0, 0.8])
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    assert tried[0].name == "transfer function"
    assert phase1.benchmark.nonlinearity is None
    # Noise of 0.02 mm over two thousand samples.
    assert tried[0].held_out_rmse == pytest.approx(0.02, rel=0.1)
    assert [form.chosen for form in tried] == [True] + [False] * (len(tried) - 1)
    # Nested forms fit no worse, but that a spool lags by 1 ms at least, at 20 mm/s.
    for form in tried:
        lags = 0.02 if form.spec.spool_dynamics else 0.0
        assert form.rmse <= np.hypot(tried[0].rmse * (1 + 1e-6), lags)


def test_a_valve_curve_is_found_where_there_is_one(make_record):
    batch = simulated(make_record, CURVED, CURVED_VALUES)
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    named = {form.name: form for form in tried}
    assert named["with valve curve"].held_out_rmse < 0.1 * named["transfer function"].held_out_rmse
    assert phase1.benchmark.nonlinearity is not None
    assert phase1.rmse == pytest.approx(0.02, rel=0.1)
    command = jnp.linspace(0.2, 0.9, 30)[None]
    true = CURVED.physical_model(jnp.asarray(CURVED_VALUES), SCALES)
    speeds = [model.values[0] * model.nonlinearity.flow(command) for model in (phase1.benchmark, true)]
    np.testing.assert_allclose(*speeds, rtol=0.02)


def test_what_the_tests_do_not_miss_goes(make_record):
    powered = replace(CURVED, without=("opening", "saturation"))
    batch = simulated(make_record, powered, [20.0, 15.0, 0.8, 1.6])
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    (chosen,) = (form for form in tried if form.chosen)
    # The plant has these parameters; at a level of 5 % one of the five others may stay by chance.
    names = {parameter.name for parameter in chosen.spec.parameters}
    assert names >= {"gain", "natural_frequency", "damping_ratio", "exponent"}
    assert len(names) <= 5
    assert all(estimate.determined for estimate in phase1.parameter_estimates)
    grown = next(form for form in tried if form.name == "with valve curve")
    assert chosen.base
    assert chosen.held_out_rmse < 1.02 * grown.held_out_rmse


def test_a_lag_of_first_order_is_found_behind_one_of_second(make_record):
    lagging = ModelSpec(structure_named("integrator-first-order"), valve_curve=True)
    batch = simulated(make_record, lagging, [20.0, 0.2, 0.05, 2.0, 0.6])
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    assert phase1.benchmark.structure.name == "integrator-first-order"
    (chosen,) = (form for form in tried if form.chosen)
    assert chosen.named_values["time_constant"] == pytest.approx(0.2, rel=0.05)


def test_a_dead_zone_too_large_is_found_anew(make_record):
    batch = simulated(make_record, CURVED, CURVED_VALUES, dead_zone=0.1)
    phase1, tried = choose_spec(
        batch.with_dead_zone(0.4), AutoStructure(PLAIN), SEARCH, 0, units=UNITS, revised=True
    )
    (taken,) = (form for form in tried if form.chosen)
    assert [form.dead_zone for form in tried[:2]] == [0.4, 0.4]
    assert taken.dead_zone < 0.4
    # Noise of 0.02 mm; with 0.4 A some of the way is driven by commands that count as none.
    assert phase1.rmse < 0.03


LAG = ModelSpec(structure_named("first-order-lag"))


@pytest.mark.parametrize("tests", [8, 2], ids=["held out in turn", "nothing to hold out"])
def test_a_piston_that_goes_back_has_no_integrator(make_record, tests):
    batch = simulated(make_record, LAG, [20.0, 0.8], tests=tests, pauses=True)
    assert goes_back(batch)
    phase1, _ = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    assert phase1.benchmark.structure.name == "first-order-lag"
    assert phase1.rmse == pytest.approx(0.02, rel=0.1)
    assert dict(zip(("gain", "tau"), phase1.fit.values, strict=False)) == pytest.approx(
        {"gain": 20.0, "tau": 0.8}, rel=0.01
    )


@pytest.mark.parametrize(
    ("returns", "expected"),
    [([0.06] * 10, True), ([0.04] * 10, False), ([0.06] * 2, False), ([0.5] * 8 + [-0.01] * 2, False)],
    ids=["a twentieth", "less", "too few stretches", "not always"],
)
def test_a_piston_goes_back_by_a_twentieth_nine_times_of_ten(make_record, returns, expected):
    # Strokes of 10 mm, after each of which the piston goes back by a share of the way.
    command = np.repeat([1.0, 0.0], 50)
    records = []
    for share in returns:
        left = np.where(np.arange(50) < 5, 90.0, 90.0 - 10 * share)
        records.append(make_record(np.concatenate([np.linspace(80.0, 90.0, 50), left]), command))
    assert goes_back(Batch.of(records, LIFTING, dead_zone=0.0, sign=1)) == expected


def test_a_piston_that_stays_or_sags_a_little_keeps_its_integrator(make_record):
    batch = simulated(make_record, PLAIN, [20.0, 15.0, 0.1], pauses=True)  # swings when it is stopped
    assert not goes_back(batch)


def test_folds_hold_out_levels_between_the_extremes(make_record):
    records = [make_record(np.linspace(80.0, 90.0, 100), np.full(100, level)) for level in (1, 1, 2, 3, 4, 4)]
    batch = Batch.of(records, LIFTING, dead_zone=0.0, sign=1)
    folds = operating_point_folds(batch, separate_tests=False)
    assert [list(np.flatnonzero(fold)) for fold in folds] == [[2], [3]]
    alone = operating_point_folds(batch, separate_tests=True)
    assert sorted(int(np.flatnonzero(fold)[0]) for fold in alone) == [1, 2, 3, 4]


def test_tests_of_one_level_leave_the_plain_form(make_record):
    batch = simulated(make_record, PLAIN, [20.0, 15.0, 0.8], tests=1)
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    assert tried == ()
    assert phase1.benchmark.nonlinearity is None


def test_a_hysteresis_is_found_with_its_width(make_record):
    played = replace(CURVED, spool_dynamics=True)
    values = [20.0, 15.0, 0.8, 0.02, 1.3, 1.5, 0.3, 0.02]
    true = dict(zip((p.name for p in played.parameters), values, strict=True))
    batch = simulated(make_record, played, values, dead_zone=0.3)
    phase1, tried = choose_spec(batch, AutoStructure(PLAIN), SEARCH, 0, units=UNITS)
    named = {form.name: form for form in tried}
    with_play, without = (named[name] for name in ("with spool lag and hysteresis", "with valve curve"))
    assert better_on_held_out_tests(with_play.held_out, without.held_out)
    assert with_play.held_out_rmse == pytest.approx(np.sqrt(np.mean(with_play.held_out**2)), rel=1e-15)
    assert with_play.held_out_rmse < 0.5 * without.held_out_rmse
    assert phase1.rmse == pytest.approx(0.02, rel=0.1)
    (width,) = (
        quantity for quantity in phase1.assessment.derived if quantity.name == "width of the hysteresis"
    )
    (error,) = (estimate.error for estimate in phase1.parameter_estimates if estimate.name == "hysteresis")
    assert width.unit == "A"
    # Three standard errors, which are a tenth of the width at most.
    assert 3 * error * 0.3 < 0.1 * width.value
    assert width.value == pytest.approx(0.3 * true["hysteresis"], abs=3 * error * 0.3)


def test_the_settings_file_asks_for_a_choice_or_for_curves(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text(
        '[lifting]\nstructure = "automatic"\nload = "pressure"\n'
        '[lowering]\nstructure = "first-order-lag"\ncurve = true\nspool = true\n'
    )
    forms = read_settings(path).get("structure", {})
    assert forms["lifting"] == AutoStructure(PLAIN, covariate_names=("pressure",))
    lag = structure_named("first-order-lag")
    assert forms["lowering"] == ModelSpec(lag, valve_curve=True, spool_dynamics=True)
    path.write_text("")
    assert read_settings(path).get("structure") == dict(DEFAULT_STRUCTURES)
    # A choice starts from what stands still without a command.
    assert DEFAULT_STRUCTURES[LIFTING] == AutoStructure(PLAIN)
    assert DEFAULT_STRUCTURES[LOWERING].baseline_spec.structure.name == "integrator-first-order"


@pytest.mark.parametrize(
    ("keys", "decided"),
    [
        ("curve = true", "curve"),
        ('structure = "automatic"\ndead_time = true\nspool = true', "dead_time and spool"),
        ("bounds = { gain = [1.0, 2.0] }", "bounds"),
    ],
)
def test_a_choice_does_not_go_with_what_it_decides_itself(tmp_path, keys, decided):
    path = tmp_path / "settings.toml"
    path.write_text(f"[lifting]\n{keys}\n")
    with pytest.raises(SettingsError, match=f"lifting: .*'automatic'.*{decided}"):
        read_settings(path)


def loaded(make_record, *, tests=12):
    """Return tests: speed follows a pressure, damping an oil temperature, and a flow changes nothing."""
    rng = np.random.default_rng(8)
    names = ("flow", "oil", "pressure")
    rows = rng.uniform((1.0, 5.0, 60.0), (9.0, 70.0, 140.0), (tests, 3)).T
    covariates = dict(zip(names, rows, strict=True))
    commands = [level * levels(rng, SAMPLES, low=0.6) for level in np.linspace(0.4, 1.0, tests)]
    scaled = {name: (rows - rows.mean()) / rows.std() for name, rows in covariates.items()}
    records = []
    for number, command in enumerate(commands):
        gain, damping_ratio = 0.2 * scaled["pressure"][number], -0.6 * scaled["oil"][number]
        values = [20.0 * np.exp(gain), 15.0, 0.4 * np.exp(damping_ratio)]
        still = make_record(np.full(SAMPLES, 80.0), command)
        batch = Batch.of([still], LIFTING, dead_zone=0.0, sign=1)
        travel = np.asarray(PLAIN.physical_model(jnp.asarray(values), SCALES).travel(batch))[0, :SAMPLES]
        record = make_record(80.0 + travel + 0.02 * rng.standard_normal(SAMPLES), command)
        signals = {name: np.full(SAMPLES, rows[number]) for name, rows in covariates.items()}
        units = {**record.units, "flow": "l/min", "oil": "degC", "pressure": "bar"}
        records.append(replace(record, signals={**record.signals, **signals}, units=units))
    return Batch.of(records, LIFTING, dead_zone=0.0, sign=1, covariates=names)


@pytest.mark.long
def test_covariates_are_kept_where_they_change_something(make_record):
    batch = loaded(make_record)
    auto = AutoStructure(PLAIN, batch.covariate_names)
    phase1, tried = choose_spec(batch, auto, SEARCH, 0, units=UNITS)
    (chosen,) = (form for form in tried if form.chosen)
    assert set(chosen.spec.covariate_names) == {"pressure", "oil"}
    assert {name for form in tried for name in form.spec.covariate_names} == {"flow", "oil", "pressure"}
    named = {estimate.name: estimate for estimate in phase1.parameter_estimates}
    # Noise of 0.02 mm on 60 mm of travel is 1e-4 of the speed; the curves of the valve take a part.
    assert named["gain_by_pressure"].value == pytest.approx(0.2, rel=0.01)
    assert named["damping_ratio_by_oil"].value == pytest.approx(-0.6, rel=0.05)
    # Noise of 0.02 mm; without the covariates a speed that differs by 20 % from test to test.
    assert phase1.rmse == pytest.approx(0.02, rel=0.1)
    assert tried[0].held_out_rmse > 1.0


def test_a_covariate_taken_before_is_widened_once_another_is_known():
    # The square of the pressure is hidden as long as the oil is not known: 1 % of the error then, half after.
    def error(spec):
        by_name = {effects.covariate: effects for effects in spec.covariates}
        pressure, oil = by_name.get("pressure"), by_name.get("oil")
        if pressure is None:
            return 1.0
        return 0.5 if oil is None else 0.1 if pressure.quadratic else 0.2

    def candidate(name, spec):
        errors = error(spec) * np.exp(0.01 * np.random.default_rng(0).standard_normal(12))
        return Candidate(
            name=name,
            spec=spec,
            values=np.zeros(1),
            rmse=1.0,
            rmse_per_test_gain=1.0,
            observations=np.full(2, 100.0),
            dead_zone=0.0,
            held_out=errors,
            held_out_per_test_gain=errors,
            fold=np.arange(12) % 4,
        )

    def fit(base, specs):
        return [candidate(name, spec) for name, spec in specs]

    candidates = covariate_candidates([candidate("plain", PLAIN)], ["oil", "pressure"], fit)
    best = candidates[best_candidate(candidates)].spec
    quadratic = {effects.covariate: effects.quadratic for effects in best.covariates}
    assert quadratic == {"pressure": True, "oil": False}
    assert len({form.spec for form in candidates}) == len(candidates)


def test_a_covariate_with_all_effects_has_no_larger_form():
    largest = replace(PLAIN, covariates=(CovariateEffects("oil", True, True),))
    assert covariate_specs(largest, "oil") == []
    assert len(covariate_specs(largest, "pressure")) == 3
