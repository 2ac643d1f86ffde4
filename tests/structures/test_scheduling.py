"""Parameters that vary with covariates, against models with the parameters of one load."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.estimation import Objective
from hitchid.logs.record import LIFTING
from hitchid.structures import Batch, CovariateEffects, ModelSpec, PhysicalModel, structure_named
from hitchid.structures.nonlinearity import MAX_QUADRATIC_SPREADS, MAX_SPREADS
from truth import levels

SECOND_ORDER = structure_named("integrator-second-order")
VALUES = (20.0, 12.0, 0.5)
EFFECTS = {"gain": 0.2, "gain_squared": -0.05, "natural_frequency": -0.1, "damping_ratio": 0.4}
EFFECTS["opening"] = 0.03
LOADS = (95.0, 120.0, 157.5)
SPEC = ModelSpec(
    SECOND_ORDER,
    dead_time=True,
    valve_curve=True,
    spool_dynamics=True,
    covariates=(CovariateEffects("pressure", dynamics=True, quadratic=True), CovariateEffects("oil")),
)


def model():
    curves = handmade.scheduled(SECOND_ORDER, centre=120.0, spread=25.0, **EFFECTS)
    return PhysicalModel(SECOND_ORDER, jnp.array(VALUES), jnp.asarray(0.03), *curves)


def batch_of(make_record, loads, **more):
    rng = np.random.default_rng(1)
    records = []
    for load in loads:
        record = make_record(np.linspace(80.0, 110.0, 300), levels(rng, 300))
        signals = {name: np.full(300, value) for name, value in {"pressure": load, **more}.items()}
        units = {**record.units, **dict.fromkeys(signals, "bar")}
        records.append(replace(record, signals={**record.signals, **signals}, units=units))
    return Batch.of(records, LIFTING, dead_zone=0.2, sign=1, covariates=["pressure", *more])


def test_each_test_has_the_parameters_of_its_load(make_record):
    batch = batch_of(make_record, LOADS)
    computed = np.asarray(model().travel(batch))
    assert np.ptp(computed[:, 299]) > 1.0
    for row, load in enumerate(LOADS):
        z = (load - 120.0) / 25.0
        square = 0.2 * z - 0.05 * min(z, MAX_QUADRATIC_SPREADS) ** 2
        values = np.array(VALUES) * np.exp([square, -0.1 * z, 0.4 * z])
        curves = handmade.scheduled(SECOND_ORDER, (handmade.CURVES[0] + 0.03 * z, *handmade.CURVES[1:]))
        # A load shifts the curve and does not stretch it: at the largest command more or less flows.
        values[0] *= curves[0].largest_share / model().nonlinearity.largest_share
        alone = PhysicalModel(SECOND_ORDER, jnp.array(values), jnp.asarray(0.03), curves[0])
        expected = np.asarray(alone.travel(batch.take([row])))[0]
        np.testing.assert_allclose(computed[row], expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_a_model_at_a_load_stands_beyond_three_standard_deviations():
    edge = 120.0 + 25.0 * MAX_SPREADS
    here, far = (model().at_load(jnp.array([load])) for load in (edge, edge + 1000.0))
    np.testing.assert_array_equal(here.values, far.values)
    assert float(model().at_load(jnp.array([120.0])).gain) == VALUES[0]
    assert model().covariates == ("pressure",)
    at_load = model().at_load(jnp.array([100.0]))
    assert at_load.covariates == ()
    assert at_load.at_load(jnp.array([7.0])) is at_load


def test_parameters_are_named_for_quantity_and_covariate():
    names = [parameter.name for parameter in SPEC.covariate_parameters]
    quantities = ("gain", "natural_frequency", "damping_ratio", "opening")
    by_pressure = [f"{name}_by_pressure{power}" for power in ("", "_squared") for name in quantities]
    assert names == [*by_pressure, "gain_by_oil", "opening_by_oil"]
    computed = model().named_values()
    assert computed["gain_by_pressure_squared"] == pytest.approx(-0.05)
    assert computed["opening_by_pressure"] == pytest.approx(0.03)


def test_searched_values_reach_the_effects_they_are_named_for(make_record):
    batch = batch_of(make_record, LOADS, oil=5.0)
    objective = Objective.of(batch, SPEC)
    names = [parameter.name for parameter in SPEC.parameters]
    values = np.linspace(0.1, 0.9, len(names))
    computed = SPEC.physical_model(jnp.asarray(values), objective.scales).named_values()
    assert {name: computed[name] for name in names} == pytest.approx(dict(zip(names, values, strict=True)))
    assert computed["natural_frequency_by_oil"] == 0.0
    vector = SPEC.physical_model(jnp.asarray(values), objective.scales).parameter_vector
    again = model().with_parameter_vector(model().parameter_vector)
    np.testing.assert_array_equal(again.parameter_vector, model().parameter_vector)
    assert vector.size == len(SECOND_ORDER.parameters) + 1 + 7 + 4 * 2 * 2


def test_derivatives_of_all_parameters_are_finite(make_record):
    objective = Objective.of(batch_of(make_record, LOADS, oil=5.0), SPEC)
    position = jnp.full(len(SPEC.parameters), 0.5)
    slopes = jax.jacfwd(lambda position: objective.residuals(position))(position)
    assert np.all(np.isfinite(slopes))
    named = dict(zip((p.name for p in SPEC.parameters), np.abs(slopes).max(axis=(0, 1)), strict=True))
    assert named["damping_ratio_by_pressure"] > 0
    # The oil is as warm in every test: its spread counts as one, and it changes nothing.
    assert named["gain_by_oil"] == 0.0
