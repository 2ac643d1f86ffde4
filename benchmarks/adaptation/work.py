"""A working day on the virtual bench: strokes and pauses while implement, oil and pump change."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.plant import Rig, rig_limits
from hitchid.bench.simulation import SAMPLE_S
from hitchid.bench.stepping import BenchState, reset, step
from hitchid.bench.virtual_campaign import LITRES_PER_MIN, in_condition
from hitchid.errors import InputError
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, Record

ENDS = ((0.55, 0.6), (0.4, 0.45))  # shares of the stroke where lifting and lowering end; tests reach both
SWITCH = (0.2, 0.8)  # share of a stroke's way at which its command changes level; chosen
LONGEST_STROKE_S = 20.0  # s, after which a stroke that does not arrive is given up; chosen
START = 0.42  # share of the stroke; chosen


@short_repr
class Work(NamedTuple):
    """Strokes and pauses of one machine.

    Attributes:
        record: commands, A, and measured displacement, mm, at 100 Hz.
        truth: displacement without sensor and noise, mm, shape [N].
    """

    record: Record
    truth: Float[np.ndarray, " n"]


class _Plan(NamedTuple):
    """What the operator does in each stroke, drawn beforehand, shape [S, …].

    Attributes:
        ends: displacement at which each stroke ends, m.
        levels: of the command before and after the switch, A, shape [S, 2].
        switches: share of the way at which the command changes.
        pauses: samples before each stroke.
    """

    ends: Float[Array, " s"]
    levels: Float[Array, "s 2"]
    switches: Float[Array, " s"]
    pauses: Int[Array, " s"]


class _Operator(NamedTuple):
    """Where the operator is: number of the stroke, whether it moves, samples in it, where it began, m."""

    stroke: Int[Array, ""]
    moves: Bool[Array, ""]
    samples: Int[Array, ""]
    start: Float[Array, ""]


@double_precision
def work(
    rig: Rig,
    commands: Mapping[str, tuple[float, float]],
    *,
    duration_s: float,
    pause_s: tuple[float, float] = (1.0, 3.0),
    ends: tuple[tuple[float, float], tuple[float, float]] = ENDS,
    implement_kg: ArrayLike | None = None,
    oil_degc: ArrayLike | None = None,
    pump_l_min: ArrayLike | None = None,
    seed: int = 0,
    name: str = "work",
) -> Work:
    """Return what a machine does whose operator lifts and lowers in turn, with pauses.

    Each stroke ends at a place drawn at random, on the way to which the command has two levels.

    Args:
        rig: the bench at the start.
        commands: direction to lowest and highest current of the strokes, A.
        duration_s: length, s.
        pause_s: shortest and longest pause, s.
        ends: shares of the stroke between which lifting ends, and lowering.
        implement_kg, oil_degc, pump_l_min: mass of the implement, kg, oil temperature, °C, and flow of the
            pump, l/min, at each sample, shape [] or [N]; those of the rig by default.
        seed: of the operator and of the sensor's noise.
        name: of the record.

    Raises:
        InputError: an argument is invalid.
    """
    samples = round(checks.number(duration_s, "duration_s", above=0.0) / SAMPLE_S)
    plan = _plan(rig, commands, samples, pause_s, ends, np.random.default_rng(seed))
    flow = rig.supply.pump_flow if pump_l_min is None else LITRES_PER_MIN * np.asarray(pump_l_min)
    changing = []
    for label, value in (
        ("implement_kg", rig.linkage.implement_mass if implement_kg is None else implement_kg),
        ("oil_degc", rig.oil.temperature if oil_degc is None else oil_degc),
        ("pump_l_min", flow),
    ):
        array = np.asarray(value, float)
        if array.shape not in ((), (samples,)) or not np.all(np.isfinite(array)):
            raise InputError(f"{label}: expected a number or {samples} numbers, got shape {array.shape}")
        changing.append(jnp.broadcast_to(jnp.asarray(array), (samples,)))
    rows = _work(rig, plan, jnp.stack(changing, axis=1), jax.random.key(seed))
    currents, measured, truth = (np.asarray(row) for row in rows)
    signals = {COMMAND[direction]: currents[:, number] for number, direction in enumerate(DIRECTIONS)}
    units = {**dict.fromkeys(signals, "A"), DISPLACEMENT: "mm"}
    record = Record(name, SAMPLE_S, {**signals, DISPLACEMENT: measured}, units)
    return Work(record, truth)


def _plan(
    rig: Rig,
    commands: Mapping[str, tuple[float, float]],
    samples: int,
    pause_s: tuple[float, float],
    places: tuple[tuple[float, float], tuple[float, float]],
    rng: np.random.Generator,
) -> _Plan:
    """Draw the strokes; there are never more than pauses fit."""
    shortest, longest = (max(1, round(seconds / SAMPLE_S)) for seconds in pause_s)
    count = samples // shortest + 1
    stroke_m = rig_limits(rig).stroke_m
    ends, levels = np.empty(count), np.empty((count, 2))
    for number, direction in enumerate(DIRECTIONS):
        of_direction = ends[number::2].size
        ends[number::2] = stroke_m * rng.uniform(*places[number], of_direction)
        levels[number::2] = rng.uniform(*commands[direction], (of_direction, 2))
    pauses = rng.integers(shortest, longest + 1, count)
    switches = rng.uniform(*SWITCH, count)
    return _Plan(*(jnp.asarray(rows) for rows in (ends, levels, switches, pauses)))


@eqx.filter_jit
def _work(
    rig: Rig, plan: _Plan, changing: Float[Array, "n 3"], key: PRNGKeyArray
) -> tuple[Float[Array, "n 2"], Float[Array, " n"], Float[Array, " n"]]:
    """Return currents, A, measured displacement and true displacement, mm, at each sample."""

    def advance(
        state: tuple[BenchState, Array, _Operator], row: Float[Array, "3"]
    ) -> tuple[tuple[BenchState, Array, _Operator], tuple[Array, Array, Array]]:
        bench, measured, operator = state
        operator, currents = _operate(plan, operator, bench.plant.displacement)
        later, measurement = step(in_condition(rig, tuple(row)), bench, currents)
        # The reading of a current that is held until the next sample is that of its end, as in a log.
        shown = (measurement.currents_a, measured, 1e3 * bench.plant.displacement)
        return (later, measurement.displacement_mm, operator), shown

    start = START * rig.cylinder.stroke
    bench, measurement = reset(in_condition(rig, tuple(changing[0])), key, initial_displacement_m=start)
    operator = _Operator(jnp.zeros((), int), jnp.zeros((), bool), jnp.zeros((), int), start)
    return jax.lax.scan(advance, (bench, measurement.displacement_mm, operator), changing)[1]


def _operate(
    plan: _Plan, operator: _Operator, displacement: Float[Array, ""]
) -> tuple[_Operator, Float[Array, "2"]]:
    """Return the operator at this sample, and the currents until the next one."""
    stroke = operator.stroke
    lowers = stroke % 2
    way = plan.ends[stroke] - operator.start
    covered = (displacement - operator.start) / jnp.where(way == 0, 1.0, way)
    arrived = operator.moves & ((covered >= 1) | (operator.samples > LONGEST_STROKE_S / SAMPLE_S))
    begins = ~operator.moves & (operator.samples >= plan.pauses[stroke])
    changes = arrived | begins
    operator = _Operator(
        stroke + arrived,
        jnp.where(begins, True, operator.moves & ~arrived),
        jnp.where(changes, 0, operator.samples + 1),
        jnp.where(begins, displacement, operator.start),
    )
    level = plan.levels[stroke, (covered >= plan.switches[stroke]).astype(int)]
    level = jnp.where(operator.moves, jnp.where(begins, plan.levels[stroke, 0], level), 0.0)
    return operator, level * jnp.array([1 - lowers, lowers])
