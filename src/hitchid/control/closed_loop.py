"""Closed loops of a position controller on the virtual bench, many at once."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hitchid import bench as bench
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench import Disturbance, Rig
from hitchid.bench.simulation import SAMPLE_S
from hitchid.errors import InputError

CHUNK = 500  # samples of a compiled run: scenarios of any length share one program; chosen


@runtime_checkable
class PositionController(Protocol):
    """Anything that brings a hitch to a position, once every 10 ms.

    An Equinox module is traced by JAX and runs many loops at once; any other object runs loop by loop, with
    plain numbers.
    """

    def initial_state(self, displacement: object, /) -> object:
        """Return the state of a hitch that is held at a displacement."""
        ...

    def step(self, state: object, target: object, measured: object, /) -> tuple[object, object]:
        """Return the next state, and lifting and lowering command; a lost measurement is NaN."""
        ...


@runtime_checkable
class Plant(Protocol):
    """Anything that two commands move, one sample at a time, in the units of its controller.

    An Equinox module is traced by JAX and runs many loops at once; any other object runs loop by loop, with
    plain numbers.
    """

    def reset(self, displacement: Any, seed: Any, /) -> tuple[Any, Any]:
        """Return the state of a plant that is held at a displacement, and its first measurement.

        Args:
            displacement: at which it is held.
            seed: of noise and whatever else is drawn, a whole number.
        """
        ...

    def step(self, state: Any, commands: Any, /) -> tuple[Any, Any]:
        """Return the next state, and the measurement after a sample of lifting and lowering command."""
        ...


@short_repr
class Surroundings(NamedTuple):
    """What acts on the bench over time, each a number or one a sample, shape [N].

    Attributes:
        implement_kg: mass of the implement; None for that of the rig.
        oil_c: oil temperature, °C; None for that of the rig.
        surface_mm: displacement at which the implement touches the soil.
        soil_n_per_mm: downward force of the soil over depth; zero without soil.
        sensor_lost: whether the angle sensor gives no reading.
        leakage_factor: on the leakage past piston and valves, which grows with wear.
        dead_zone_change_a: of both valves' dead zones, which wear shortens or lengthens, A.
    """

    implement_kg: Float[np.ndarray, "*n"] | float | None = None
    oil_c: Float[np.ndarray, "*n"] | float | None = None
    surface_mm: Float[np.ndarray, "*n"] | float = 0.0
    soil_n_per_mm: Float[np.ndarray, "*n"] | float = 0.0
    sensor_lost: np.ndarray | bool = False
    leakage_factor: Float[np.ndarray, "*n"] | float = 1.0
    dead_zone_change_a: Float[np.ndarray, "*n"] | float = 0.0


@short_repr
class ClosedLoops(NamedTuple):
    """Signals of closed loops at 10 ms.

    Attributes:
        target: shape [N].
        displacement: true, shape [T, N].
        measured: shape [T, N].
        commands: over the sample that follows, lifting and lowering, shape [T, N, 2].
    """

    target: Float[np.ndarray, " n"]
    displacement: Float[np.ndarray, "t n"]
    measured: Float[np.ndarray, "t n"]
    commands: Float[np.ndarray, "t n 2"]

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Time since the start, s."""
        return SAMPLE_S * np.arange(self.target.size)


class _Sample(NamedTuple):
    """Inputs of one sample."""

    target: Array
    implement_kg: Array
    oil_c: Array
    surface_mm: Array
    soil_n_per_mm: Array
    sensor_lost: Array
    leakage_factor: Array
    dead_zone_change_a: Array


@double_precision
def run_closed_loops(
    controller: PositionController,
    rig: Rig,
    key: PRNGKeyArray,
    target_mm: Float[np.ndarray, " n"],
    *,
    start_mm: float,
    implement_factors: Float[np.ndarray, " t"],
    surroundings: Surroundings = Surroundings(),  # noqa: B008
) -> ClosedLoops:
    """Run one loop for each factor on the implement's mass, each with noise of its own.

    Args:
        controller: from the target and the measured displacement to the currents.
        rig: the bench.
        key: random key of the noise.
        target_mm: of all loops, shape [N].
        start_mm: displacement at which the hitch is held at first.
        implement_factors: on the mass of the implement, shape [T].
        surroundings: of all loops.

    Raises:
        InputError: the start is not within the stroke, or the controller returns other than two currents.
    """
    samples = target_mm.size
    around = surroundings
    signals = _Sample(
        jnp.asarray(target_mm, jnp.float64),
        jnp.asarray(rig.linkage.implement_mass if around.implement_kg is None else around.implement_kg),
        jnp.asarray(rig.oil.temperature if around.oil_c is None else around.oil_c),
        jnp.asarray(around.surface_mm, jnp.float64),
        jnp.asarray(around.soil_n_per_mm, jnp.float64),
        jnp.asarray(around.sensor_lost),
        jnp.asarray(around.leakage_factor, jnp.float64),
        jnp.asarray(around.dead_zone_change_a, jnp.float64),
    )
    inputs = jax.tree.map(lambda rows: jnp.broadcast_to(rows, (samples,)), signals)
    # A sample's currents act until the measurement of the next one, whose sensor is that of its own sample.
    lost = inputs.sensor_lost
    first = jax.tree.map(lambda rows: rows[0], inputs)
    inputs = inputs._replace(sensor_lost=jnp.append(lost[1:], lost[-1]))
    factors = jnp.asarray(implement_factors, jnp.float64)
    keys = jax.random.split(key, factors.size)

    def at_rest(own: PRNGKeyArray, factor: Array) -> tuple[bench.BenchState, bench.Measurement]:
        # Held in the soil if the run begins there: a jump of the force would move it in the first sample.
        force = _soil_n(first, jnp.asarray(start_mm))
        disturbance = Disturbance(load_force_n=force, sensor_lost=first.sensor_lost)
        here = _rig_at(rig, factor, first)
        return bench.reset(here, own, initial_displacement_m=1e-3 * start_mm, disturbance=disturbance)

    starts = jax.vmap(at_rest)(keys, factors)
    if isinstance(controller, eqx.Module):
        carry = (*starts, jax.vmap(controller.initial_state)(jnp.full(factors.size, start_mm)))
        rows = in_chunks(lambda now, part: _run_chunk(controller, rig, now, factors, part), carry, inputs)
    else:
        rows = _run_plain(controller, rig, starts, factors, inputs, start_mm)
    displacement, measured, currents = rows
    return ClosedLoops(np.asarray(target_mm, float), displacement, measured, currents)


@double_precision
def run_plant_loops(
    controller: PositionController,
    plant: Plant,
    seed: int,
    target: Float[np.ndarray, " n"],
    *,
    start: float,
    loops: int,
    sensor_lost: np.ndarray | bool = False,
) -> ClosedLoops:
    """Run loops of a plant from elsewhere; what is measured stands for the displacement, too.

    Args:
        controller: from the target and the measured displacement to the commands.
        plant: to be moved.
        seed: of the first loop; the others have those that follow.
        target: of all loops, shape [N].
        start: displacement at which the plant is held at first.
        loops: number T.
        sensor_lost: whether the controller gets no measurement, shape [N].

    Raises:
        InputError: the controller returns other than two commands, or the plant no number.
    """
    lost = np.broadcast_to(np.asarray(sensor_lost), target.shape)
    if isinstance(controller, eqx.Module) and isinstance(plant, eqx.Module):
        seeds = seed + jnp.arange(loops)
        starts = jax.vmap(plant.reset, (None, 0))(jnp.asarray(start), seeds)
        state = controller.initial_state(start)
        own = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (loops, *jnp.shape(leaf))), state)
        measured, commands = in_chunks(
            lambda now, part: _run_plant_chunk(controller, plant, now, part), (*starts, own), (target, lost)
        )
    else:
        rows = [_plain_plant_loop(controller, plant, seed + k, target, lost, start) for k in range(loops)]
        measured, commands = (np.stack(signals) for signals in zip(*rows, strict=True))
    return ClosedLoops(np.asarray(target, float), measured, measured, commands)


def in_chunks(run: Callable[[Any, Any], tuple[Any, Any]], carry: Any, inputs: Any) -> Any:
    """Return what `run` gives of samples, shape [N, …], as shape [T, N, …].

    Chunk by chunk, so that runs of any length share one compiled program.
    """
    samples = len(jax.tree.leaves(inputs)[0])
    # The last sample is held to the end of the last chunk, and cut off again below.
    padded = jax.tree.map(lambda rows: np.pad(rows, (0, -samples % CHUNK), mode="edge"), inputs)
    chunks = []
    for begin in range(0, samples, CHUNK):
        part = jax.tree.map(lambda rows, b=begin: jnp.asarray(rows[b : b + CHUNK]), padded)
        carry, rows = run(carry, part)
        chunks.append(jax.tree.map(np.asarray, rows))
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1)[:, :samples], *chunks)


@eqx.filter_jit
def _run_plant_chunk(
    controller: PositionController, plant: Plant, carry: tuple, inputs: tuple[Array, Array]
) -> tuple[tuple, tuple[Array, Array]]:
    def advance(carry: tuple, sample: tuple[Array, Array]) -> tuple[tuple, tuple[Array, Array]]:
        state, measured, own = carry
        target, is_lost = sample
        own, commands = controller.step(own, target, jnp.where(is_lost, jnp.nan, measured))
        commands = jnp.asarray(commands, jnp.float64)
        return (*plant.step(state, commands), own), (measured, commands)

    return jax.vmap(lambda own: jax.lax.scan(advance, own, inputs))(carry)


def _plain_plant_loop(
    controller: PositionController,
    plant: Plant,
    seed: int,
    target: Float[np.ndarray, " n"],
    lost: np.ndarray,
    start: float,
) -> tuple[np.ndarray, np.ndarray]:
    own, rows = controller.initial_state(start), []
    state, measured = plant.reset(start, seed)
    for wanted, is_lost in zip(target, lost, strict=True):
        reading = _number(measured)
        own, commands = controller.step(own, float(wanted), np.nan if is_lost else reading)
        applied = _two_currents(commands)
        rows.append((reading, applied))
        state, measured = plant.step(state, applied)
    readings, commands = zip(*rows, strict=True)
    return np.array(readings), np.array(commands)


def _number(measured: object) -> float:
    try:
        return float(measured)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        raise InputError(f"plant: expected a number as its measurement; got {measured!r}") from None


@double_precision
def measured_at_rest(rig: Rig, key: PRNGKeyArray, displacement_mm: float, readings: int) -> float:
    """Return what the bench's sensor measures of a hitch that is held, the mean of some readings, mm."""
    held = lambda own: bench.reset(rig, own, initial_displacement_m=1e-3 * displacement_mm)[1]  # noqa: E731
    return float(jax.vmap(held)(jax.random.split(key, readings)).displacement_mm.mean())


def _rig_at(rig: Rig, factor: Array, sample: _Sample) -> Rig:
    change = sample.dead_zone_change_a
    return eqx.tree_at(
        lambda r: (
            r.linkage.implement_mass,
            r.oil.temperature,
            r.cylinder.leakage,
            r.lifting_valve.spool.dead_zone,
            r.lowering_valve.spool.dead_zone,
        ),
        rig,
        (
            factor * sample.implement_kg,
            sample.oil_c,
            sample.leakage_factor * rig.cylinder.leakage,
            rig.lifting_valve.spool.dead_zone + change,
            rig.lowering_valve.spool.dead_zone + change,
        ),
    )


def _soil_n(sample: _Sample, displacement_mm: Array) -> Array:
    return sample.soil_n_per_mm * jnp.maximum(sample.surface_mm - displacement_mm, 0.0)


def _advance(
    rig: Rig, factor: Array, state: bench.BenchState, currents: Array, sample: _Sample
) -> tuple[bench.BenchState, bench.Measurement]:
    force = _soil_n(sample, 1e3 * state.plant.displacement)
    disturbance = Disturbance(load_force_n=force, sensor_lost=sample.sensor_lost)
    return bench.step(_rig_at(rig, factor, sample), state, currents, disturbance)


@eqx.filter_jit
def _run_chunk(
    controller: PositionController, rig: Rig, carry: tuple, factors: Array, inputs: _Sample
) -> tuple[tuple, tuple[Array, Array, Array]]:
    def advance(carry: tuple, sample: _Sample, factor: Array) -> tuple[tuple, tuple[Array, Array, Array]]:
        state, measurement, own = carry
        own, currents = controller.step(own, sample.target, measurement.displacement_mm)
        currents = jnp.asarray(currents, jnp.float64)
        readings = (1e3 * state.plant.displacement, measurement.displacement_mm, currents)
        return (*_advance(rig, factor, state, currents, sample), own), readings

    def run(carry: tuple, factor: Array) -> tuple[tuple, tuple[Array, Array, Array]]:
        return jax.lax.scan(lambda now, sample: advance(now, sample, factor), carry, inputs)

    return jax.vmap(run)(carry, factors)


def _run_plain(
    controller: PositionController, rig: Rig, starts: tuple, factors: Array, inputs: _Sample, start_mm: float
) -> tuple[np.ndarray, ...]:
    """Run loop by loop, the controller outside of any compiled program."""
    loops = []
    advance = eqx.filter_jit(_advance)
    for number, factor in enumerate(factors):
        state, measurement = jax.tree.map(lambda rows, n=number: rows[n], starts)
        own, rows = controller.initial_state(start_mm), []
        for k in range(inputs.target.size):
            sample = jax.tree.map(lambda signal, k=k: signal[k], inputs)
            measured = float(measurement.displacement_mm)
            own, currents = controller.step(own, float(sample.target), measured)
            applied = _two_currents(currents)
            rows.append((1e3 * float(state.plant.displacement), measured, applied))
            state, measurement = advance(rig, factor, state, jnp.asarray(applied), sample)
        loops.append([np.array(column) for column in zip(*rows, strict=True)])
    return tuple(np.stack(signals) for signals in zip(*loops, strict=True))


def _two_currents(currents: object) -> Float[np.ndarray, "2"]:
    # A user's own controller: what it returns by mistake would be broadcast to both valves.
    try:
        values = np.asarray(currents, dtype=float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != (2,):
        raise InputError(
            f"controller: expected two currents from `step`, lifting and lowering, A; got {currents!r}"
        )
    return values
