"""One protocol over every linear benchmark structure, and what holds for all of them."""

import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from hitchid.errors import InputError
from hitchid.structures import (
    BUILT_IN,
    NONLINEARITY_PARAMETERS,
    CovariateEffects,
    ModelSpec,
    PhysicalModel,
    Scales,
    discretise,
    linearise,
    structure_named,
)
from hitchid.structures.nonlinear_structures import NonlinearStructure
from hitchid.structures.structure import LinearStructure
from truth import STEP_S, held, levels, shifted

EPS = np.finfo(np.float64).eps
SAMPLES = 200
TYPICAL = {
    "gain": 21.0,
    "time_constant": 0.3,
    "natural_frequency": 18.0,
    "damping_ratio": 0.4,
    "dead_time": 0.037,
}

UNIT = Scales(*(jnp.asarray(scale) for scale in (1.0, 0.0, 1.0)))

LINEAR = {own.name: own for own in BUILT_IN if isinstance(own, LinearStructure) and not own.has_dry_friction}

every_structure = pytest.mark.parametrize("structure", BUILT_IN, ids=lambda structure: structure.name)
every_linear_structure = pytest.mark.parametrize("structure", LINEAR.values(), ids=LINEAR.keys())


def typical(structure, dead_time_s=0.0):
    values = jnp.array([TYPICAL[parameter.name] for parameter in structure.parameters])
    return PhysicalModel(structure, values, jnp.asarray(dead_time_s))


def drawn(data, structure):
    """Draw values over six decades around the typical ones, on a logarithmic scale."""
    exponents = [data.draw(st.floats(-1.5, 1.5), label=p.name) for p in structure.parameters]
    return np.array([TYPICAL[p.name] for p in structure.parameters]) * 10.0 ** np.array(exponents)


@eqx.filter_jit
def respond(benchmark, command):
    return benchmark.response(command, STEP_S)


def response(benchmark, *commands):
    return np.asarray(respond(benchmark, jnp.asarray(np.stack(commands))))


@pytest.fixture
def command():
    return levels(np.random.default_rng(0), SAMPLES, low=-0.5, high=1.0)


def largest(*arrays):
    return max(float(np.abs(array).max()) for array in arrays)


@every_linear_structure
@given(data=st.data())
def test_state_space_and_transfer_function_describe_one_system(structure, data):
    values = drawn(data, structure)
    a, b = (np.asarray(part) for part in structure.state_space(jnp.asarray(values)))
    numerator, denominator = structure.transfer_function(tuple(values.tolist()))
    for frequency in (0.01, 0.3, 2.0, 20.0, 500.0):
        s = 1j * frequency
        resolvent = s * np.eye(len(b)) - a
        by_states = np.linalg.solve(resolvent, b)[0]
        by_fraction = np.polyval(numerator, s) / np.polyval(denominator, s)
        # Solving loses the condition number, a polynomial near a resonance what its terms cancel.
        terms = np.polyval(np.abs(denominator), frequency) / abs(np.polyval(denominator, s))
        lost = len(b) * np.linalg.cond(resolvent) + 2 * len(denominator) * terms
        assert abs(by_states - by_fraction) <= 4 * EPS * lost * abs(by_fraction)


@every_linear_structure
@given(data=st.data())
def test_discretisation_agrees_with_scipy_for_any_parameters(structure, data):
    values = jnp.asarray(drawn(data, structure))
    step_s = data.draw(st.floats(1e-3, 0.1), label="step_s")
    computed = _discretise(structure, values, jnp.asarray(step_s))
    a, b = (np.asarray(part) for part in structure.state_space(values))
    n = len(b)
    phi, gamma, *_ = signal.cont2discrete(
        (a, b[:, None], np.eye(1, n), np.zeros((1, 1))), step_s, method="zoh"
    )
    assert int(computed.delay_samples) == 0
    assert np.all(np.asarray(computed.gamma1) == 0.0)
    assert largest(computed.transition - phi) <= 1e-12 * largest(phi)
    assert largest(computed.gamma0 - gamma[:, 0]) <= 1e-12 * largest(gamma)


@eqx.filter_jit
def _discretise(structure, values, step_s):
    return discretise(structure, values, jnp.asarray(0.0), step_s)


@every_linear_structure
def test_response_agrees_with_scipy(structure, command):
    model = typical(structure)
    expected = held(*structure.transfer_function(tuple(model.values.tolist())), command)
    computed = response(model, command, 2.0 * command)
    assert largest(computed[0] - expected) <= 1e-10 * largest(expected)
    assert largest(computed[1] - 2.0 * expected) <= 2e-10 * largest(expected)
    assert computed[0, 0] == 0.0


@every_linear_structure
def test_dead_time_of_whole_samples_only_delays_the_response(structure, command):
    prompt = response(typical(structure), command, command)[0]
    for samples in (1, 3, 7):
        late = response(typical(structure, samples * STEP_S), command, command)[0]
        # 0.07 s / 0.01 s is 7 to rounding only; what is left is a command late by as little.
        assert largest(late - shifted(prompt, samples)) <= SAMPLES * EPS * largest(prompt)
        assert np.all(late[: samples + 6] == 0.0)


@every_linear_structure
def test_fractional_dead_time_agrees_with_a_finer_grid(structure, command):
    fine_command = shifted(np.repeat(command, 10), 37)
    values = tuple(typical(structure).values.tolist())
    fine = held(*structure.transfer_function(values), fine_command, STEP_S / 10)
    late = response(typical(structure, 3.7 * STEP_S), command, command)[0]
    # Both are exact for a held command; 2000 additions of rounding errors remain.
    assert largest(late - fine[::10]) <= 2000 * EPS * largest(fine)


@every_linear_structure
@pytest.mark.parametrize("dead_time_s", [0.0, 0.03, 0.037])
def test_discrete_state_space_reproduces_the_response(structure, dead_time_s, command):
    model = typical(structure, dead_time_s)
    system = linearise(model, STEP_S).to_scipy()
    computed = signal.dlsim(system, command)[1].ravel()
    expected = response(model, command, command)[0]
    # 200 additions of rounding errors in either.
    assert largest(computed - expected) <= 2 * SAMPLES * EPS * largest(expected)
    assert system.dt == STEP_S


@every_linear_structure
@pytest.mark.parametrize("dead_time_s", [0.0, 0.037])
def test_continuous_state_space_has_transfer_function_and_dead_time(structure, dead_time_s):
    system = linearise(typical(structure, dead_time_s)).to_scipy()
    numerator, denominator = structure.transfer_function(tuple(typical(structure).values.tolist()))
    frequencies = np.array([0.3, 2.0, 20.0, 200.0] if not dead_time_s else [0.3, 2.0, 20.0])
    s = 1j * frequencies
    expected = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-s * dead_time_s)
    resolvents = np.linalg.inv(s[:, None, None] * np.eye(len(system.A)) - system.A)
    # The approximant of order n departs in phase by 2 (n!)² x^(2n+1)/((2n)! (2n+1)!): 6e-9 rad at x = 0.74.
    tolerance = 1e-8 if dead_time_s else 1e-12
    np.testing.assert_allclose((system.C @ resolvents @ system.B).ravel(), expected, rtol=tolerance)


@every_linear_structure
@pytest.mark.parametrize(("step_s", "dead_time_s"), [(None, 0.0), (STEP_S, 0.0), (STEP_S, 0.037)])
def test_python_control_gets_what_scipy_gets(structure, step_s, dead_time_s):
    linear = linearise(typical(structure, dead_time_s), step_s)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours, theirs = linear.to_scipy(), linear.to_control()
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert (theirs.dt or None) == step_s
    assert (theirs.input_labels, theirs.output_labels) == (["command"], ["displacement"])


def _second_order_step(t, gain, omega, damping):
    """Return K ∫ (1 − e^(−ξ ωh t) (cos ωd t + ξ/√(1−ξ²) sin ωd t)) dt, underdamped."""
    ringing = omega * np.sqrt(1 - damping**2)
    decay = np.exp(-damping * omega * t)
    cosine, sine = np.cos(ringing * t), np.sin(ringing * t)
    lag = 2 * damping / omega
    return gain * (t - lag + decay * (lag * cosine + (2 * damping**2 - 1) / ringing * sine))


CLOSED_FORMS = {
    "integrator": lambda t, gain: gain * t,
    "integrator-first-order": lambda t, gain, tau: gain * (t - tau * (1 - np.exp(-t / tau))),
    "first-order-lag": lambda t, gain, tau: gain * tau * (1 - np.exp(-t / tau)),
    "integrator-second-order": _second_order_step,
}


@every_linear_structure
def test_step_response_is_the_closed_form(structure):
    model = typical(structure)
    computed = response(model, np.ones(SAMPLES), np.zeros(SAMPLES))
    expected = CLOSED_FORMS[structure.name](STEP_S * np.arange(SAMPLES), *model.values.tolist())
    # 200 additions of rounding errors.
    assert largest(computed[0] - expected) <= SAMPLES * EPS * largest(expected)
    assert np.all(computed[1] == 0.0)


@every_linear_structure
def test_searched_values_are_told_apart_from_the_dead_time(structure):
    late, prompt = ModelSpec(structure, dead_time=True), ModelSpec(structure)
    assert late.parameters[:-1] == prompt.parameters == structure.parameters
    values = jnp.array([TYPICAL[parameter.name] for parameter in late.parameters])
    assert late.physical_model(values, UNIT).named_values() == {
        p.name: TYPICAL[p.name] for p in late.parameters
    }
    without = prompt.physical_model(values[:-1], UNIT)
    assert without.named_values() == {p.name: TYPICAL[p.name] for p in structure.parameters}


@every_linear_structure
def test_a_benchmark_with_all_options_is_linearised(structure):
    form = ModelSpec(
        structure,
        valve_curve=True,
        spool_dynamics=True,
        stroke_gain_quadratic=True,
        covariates=(CovariateEffects("pressure", dynamics=True, quadratic=True),),
        dead_time=True,
    )
    curves = (*structure.parameters, *NONLINEARITY_PARAMETERS)
    assert form.parameters == (*curves, *form.covariate_parameters, form.parameters[-1])
    values = np.linspace(0.1, 0.9, len(form.parameters))
    curved = form.physical_model(jnp.asarray(values), UNIT)
    names = [parameter.name for parameter in form.parameters]
    assert curved.named_values() == pytest.approx(dict(zip(names, values, strict=True)))
    opening = curved.named_values()["opening"]
    linear = linearise(curved, STEP_S, command=opening + 0.1)
    assert np.all(np.isfinite(linear.a))
    assert np.any(linear.b > 0)
    with pytest.raises(InputError, match="where the valve opens; got"):
        linearise(curved, STEP_S, command=0.9 * opening)


@every_structure
def test_a_structure_is_linear_or_not_and_has_bounds(structure):
    assert isinstance(structure, LinearStructure) != isinstance(structure, NonlinearStructure)
    for parameter in structure.parameters:
        assert parameter.lower < parameter.upper
        # What is searched by its logarithm is positive.
        assert parameter.linear or parameter.lower > 0
    assert len({parameter.name for parameter in structure.parameters}) == len(structure.parameters)


@every_structure
def test_structures_are_found_by_name_and_nothing_else_is(structure):
    assert structure_named(structure.name) is structure
    with pytest.raises(InputError, match=f"'{structure.name}s'.*{structure.name}"):
        structure_named(f"{structure.name}s")
