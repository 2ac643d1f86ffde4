"""Simulation of tests: true motion of the bench under given currents."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.plant import (
    Rig,
    RigInputs,
    RigState,
    StepFactors,
    advance,
    at_rest,
    at_temperature,
    cylinder_amount,
    step_factors,
    supply_amount,
)
from hitchid.bench.valves import Scalar
from hitchid.errors import InputError

SAMPLE_S = 0.01  # s, sampling time of the data acquisition
SUBSTEPS = 8  # integration steps per sample (chosen); tests/bench compares with twice as many


@short_repr
class RigMotion(eqx.Module):
    """True motion of the bench, sampled every 10 ms, each sample at the start of its row of currents.

    All arrays have the shape [T, N]; pressures are absolute, volumes are of oil at tank pressure.

    Attributes:
        displacement_m, speed_m_s: of the piston, positive lifting.
        supply_pressure_pa, pressure_pa: in the supply line and in the cylinder.
        bristle_m: deflection of the friction model's bristles.
        lifting_spool, lowering_spool: spool positions as a fraction of their travel.
        compensator_m2: opening of the pressure compensator.
        lifting_flow_m3_s, lowering_flow_m3_s: mean flows over the 10 ms before the sample.
        pumped_m3, relieved_m3, lifted_m3, lowered_m3, leaked_m3, safety_relieved_m3: volumes that have
            flowed since the start, from the pump, over the relief valve, to the cylinder, to tank through the
            lowering valve, past the piston, and over the safety valve.
        supply_oil_m3, cylinder_oil_m3: oil in the supply line and its accumulator, in chamber and hose.
    """

    displacement_m: Float[Array, "t n"]
    speed_m_s: Float[Array, "t n"]
    supply_pressure_pa: Float[Array, "t n"]
    pressure_pa: Float[Array, "t n"]
    bristle_m: Float[Array, "t n"]
    lifting_spool: Float[Array, "t n"]
    lowering_spool: Float[Array, "t n"]
    compensator_m2: Float[Array, "t n"]
    lifting_flow_m3_s: Float[Array, "t n"]
    lowering_flow_m3_s: Float[Array, "t n"]
    pumped_m3: Float[Array, "t n"]
    relieved_m3: Float[Array, "t n"]
    lifted_m3: Float[Array, "t n"]
    lowered_m3: Float[Array, "t n"]
    leaked_m3: Float[Array, "t n"]
    safety_relieved_m3: Float[Array, "t n"]
    supply_oil_m3: Float[Array, "t n"]
    cylinder_oil_m3: Float[Array, "t n"]


@double_precision
def simulate(
    rig: Rig,
    currents: Float[Array, "..."] | Float[np.ndarray, "..."],
    *,
    initial_displacement_m: object,
    load_force_n: object = None,
    oil_temperature_c: object = None,
    substeps: int = SUBSTEPS,
) -> RigMotion:
    """Simulate tests that start at rest, the valves closed and the load held.

    Args:
        rig: the bench.
        currents: coil currents, lifting and lowering, A, shape [T, N, 2]; one row holds for 10 ms.
        initial_displacement_m: m, one for all tests or one each, shape [T].
        load_force_n: soil resistance at the implement, downward, N: shapes [], [T, 1] or [T, N]; none by
            default. The load is held at its first value before the start.
        oil_temperature_c: °C, one for all tests or one each; the rig's own by default.
        substeps: integration steps a sample.

    Raises:
        InputError: an array has another shape or is not finite, a test starts outside the stroke, a current
            is negative, or there are no substeps.
    """
    shape = np.shape(currents)
    if len(shape) != 3 or shape[2] != 2 or 0 in shape:
        raise InputError(f"currents: got shape {shape}, expected [tests, samples, 2]")
    if substeps < 1:
        raise InputError(f"substeps: got {substeps}, expected at least 1")
    tests, samples, _ = shape
    temperature = rig.oil.temperature if oil_temperature_c is None else oil_temperature_c
    load_force = 0.0 if load_force_n is None else load_force_n
    inputs = {
        "currents": jnp.asarray(currents, jnp.float64),
        "initial_displacement_m": _broadcast("initial_displacement_m", initial_displacement_m, (tests,)),
        "load_force_n": _broadcast("load_force_n", load_force, (tests, samples)),
        "oil_temperature_c": _broadcast("oil_temperature_c", temperature, (tests,)),
    }
    for name, array in inputs.items():
        check_range(name, array, -np.inf, np.inf)  # finite: one NaN would spread over the whole test
    check_range("currents", inputs["currents"], 0.0, np.inf)
    check_range("initial_displacement_m", inputs["initial_displacement_m"], 0.0, rig.cylinder.stroke)
    return _simulate(rig, **inputs, substeps=substeps)


def _broadcast(name: str, value: object, shape: tuple[int, ...]) -> Array:
    array = jnp.asarray(value, jnp.float64)
    try:
        return jnp.broadcast_to(array, shape)
    except ValueError as error:
        raise InputError(
            f"{name}: got shape {array.shape}, expected a shape that broadcasts to {shape}"
        ) from error


def check_range(name: str, array: Array, low: float, high: object) -> None:
    """Raise InputError where a value is not finite or beyond its limits; in a compiled program nothing."""
    if isinstance(array, Tracer) or isinstance(high, Tracer):
        return  # there are no values to look at
    values, top = np.asarray(array), float(np.asarray(high))
    if not np.all(np.isfinite(values)):
        raise InputError(f"{name}: a value is not finite")
    if np.any(values < low) or np.any(values > top):
        worst = values[(values < low) | (values > top)].flat[0]
        raise InputError(f"{name}: got {worst:g}, expected {low:g} to {top:g}")


@eqx.filter_jit
def _simulate(
    rig: Rig,
    currents: Float[Array, "t n 2"],
    initial_displacement_m: Float[Array, " t"],
    load_force_n: Float[Array, "t n"],
    oil_temperature_c: Float[Array, " t"],
    substeps: int,
) -> RigMotion:
    def run(rows: Array, initial: Scalar, load_force: Array, temperature: Scalar) -> RigState:
        # Once a test, outside of the scan: neither changes from sample to sample.
        warm = at_temperature(rig, temperature)
        factors = _sample_factors(warm, substeps)

        def sample(state: RigState, row: tuple[Array, Array, Array]) -> tuple[RigState, RigState]:
            return _advance_sample(warm, factors, state, *row), state

        initial_state = at_rest(warm, initial, load_force[0])
        numbers = jnp.arange(load_force.shape[0], dtype=jnp.float64)
        return jax.lax.scan(sample, initial_state, (rows, load_force, numbers))[1]

    def mean_flow(volume: Float[Array, "t n"]) -> Float[Array, "t n"]:
        return jnp.diff(volume, axis=1, prepend=volume[:, :1]) / SAMPLE_S

    states = jax.vmap(run)(currents, initial_displacement_m, load_force_n, oil_temperature_c)
    oils = states.oils
    return RigMotion(
        displacement_m=states.displacement,
        speed_m_s=states.speed,
        supply_pressure_pa=states.supply_pressure,
        pressure_pa=states.pressure,
        bristle_m=states.bristle,
        lifting_spool=states.lifting.position,
        lowering_spool=states.lowering.position,
        compensator_m2=states.compensator,
        lifting_flow_m3_s=mean_flow(oils.lifted),
        lowering_flow_m3_s=mean_flow(oils.lowered),
        **{f"{name}_m3": volume for name, volume in oils._asdict().items()},
        supply_oil_m3=supply_amount(states),
        cylinder_oil_m3=cylinder_amount(states),
    )


class _SampleFactors(NamedTuple):
    """What does not change from sample to sample: factors of a step, and the phase and size of the ripple."""

    steps: StepFactors
    ripple_phase_step: Scalar
    ripple_amplitude: Scalar
    substeps: int


def _sample_factors(rig: Rig, substeps: int) -> _SampleFactors:
    steps = step_factors(rig, jnp.asarray(SAMPLE_S / substeps))
    phase_step = rig.supply.ripple_frequency * steps.dt
    return _SampleFactors(
        # The mean of a sine over a step is its value in the middle times the sinc of half the step.
        steps,
        phase_step,
        rig.supply.ripple * jnp.sinc(phase_step / (2 * jnp.pi)),
        substeps,
    )


def _advance_sample(
    rig: Rig,
    factors: _SampleFactors,
    state: RigState,
    currents: Float[Array, "2"],
    load_force: Scalar,
    number: Scalar,
) -> RigState:
    """Return the bench 10 ms later; see `advance_sample`. `rig` is at its oil temperature."""
    # In 10 ms the linkage hardly moves: its load is linear around the displacement at the start.
    load, origin = rig.linkage.load(state.displacement), state.displacement
    inputs = RigInputs(currents[0], currents[1], load_force)
    start = rig.supply.ripple_frequency * SAMPLE_S * number

    def substep(index: Array, inner_state: RigState) -> RigState:
        phase = start + (index + 0.5) * factors.ripple_phase_step
        ripple = 1 + factors.ripple_amplitude * jnp.sin(phase)
        return advance(rig, load, origin, inner_state, inputs, ripple, factors.steps)

    return jax.lax.fori_loop(0, factors.substeps, substep, state)


def advance_sample(
    rig: Rig, state: RigState, currents: Float[Array, "2"], load_force: Scalar, number: Scalar
) -> RigState:
    """Return the bench 10 ms later, at the rig's oil temperature.

    Currents, A, and load, N, are held; the pump's ripple follows the number of the sample since the start.
    """
    warm = at_temperature(rig, rig.oil.temperature)
    return _advance_sample(warm, _sample_factors(warm, SUBSTEPS), state, currents, load_force, number)
