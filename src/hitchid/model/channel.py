"""Model of one direction of a hitch: dead zone, benchmark, compensators."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.logs.kinds import CommandThreshold
from hitchid.logs.record import COMMAND, Record
from hitchid.logs.units import conversion_factor
from hitchid.model.limits import TravelLimits
from hitchid.model.load_filter import ErrorEstimate, LoadFilter
from hitchid.networks.error_compensator import Compensator, CompensatorState, Sample, free_run
from hitchid.networks.operating_range import OperatingRange
from hitchid.networks.speed_compensator import SpeedCompensator, simulate_compensated
from hitchid.structures import Batch, PhysicalModel

# Predictions of the error of a benchmark over several horizons, from every sample of measured tests.


@eqx.filter_jit
def predict_errors(
    load_filter: LoadFilter,
    compensator: Compensator | None,
    tests: Sample,
    trust: Float[Array, "t n"],
    horizons: tuple[int, ...],
    step_s: float,
    every: int = 1,
) -> Float[Array, "h t n"]:
    """Return the prediction ê at every sample from measurements up to h samples before, for each h.

    The filter estimates offset and load, the compensator, if any, predicts the innovations of the filter.
    Near the start of a test, sample k < h is predicted from sample 0. The trust, 0 to 1, is a factor on the
    predicted increments. Predictions start from every `every`-th sample; those from other samples are NaN.
    """

    def errors_of_test(test_and_trust: tuple[Sample, Array]) -> Float[Array, "h n"]:
        test, test_trust = test_and_trust
        errors_ahead = multi_step_errors(
            load_filter, compensator, test, test_trust, max(horizons), step_s, every
        )
        # errors_ahead[h − 1, i] is for sample i · every + h; the origin of the first samples is sample 0.
        sample_index = jnp.arange(test_trust.size)
        rows = []
        for horizon in horizons:
            steps = jnp.minimum(sample_index, horizon)
            origin = sample_index - steps
            errors = errors_ahead[jnp.maximum(steps - 1, 0), origin // every]
            errors = jnp.where(origin % every == 0, errors, jnp.nan)
            rows.append(jnp.where(sample_index > 0, errors, 0.0))
        return jnp.stack(rows)

    return jnp.moveaxis(jax.lax.map(errors_of_test, (tests, trust)), 1, 0)


def multi_step_errors(
    load_filter: LoadFilter,
    compensator: Compensator | None,
    test: Sample,
    trust: Float[Array, " n"],
    horizon: int,
    step_s: float,
    every: int = 1,
) -> Float[Array, "h m"]:
    """Return ê(i+h) for h = 1 … horizon from every m-th sample i of one measured test, arrays of shape [N].

    To the error that the filter predicts the compensator adds the innovation to come, times the trust, up to
    its largest horizon. Up to the origin filter and features use measurements, beyond it the model's output.
    """
    count = trust.shape[0]
    origins = np.arange(0, count, every)
    _, estimates = load_filter.estimates(test.benchmark, test.displacement, step_s, every)

    def filtered(estimates: ErrorEstimate, first: int) -> Float[Array, "k m"]:
        """Return the errors after samples first + 1 … horizon, from the estimates after sample `first`."""
        ahead = origins + jnp.arange(first, horizon + 1)[:, None]
        increments = jnp.diff(test.benchmark[jnp.minimum(ahead, count - 1)], axis=0)
        return load_filter.ahead(estimates, increments, np.arange(1, horizon - first + 1), step_s)[0]

    if compensator is None:
        return filtered(estimates, 0)
    corrected = min(horizon, compensator.max_horizon)

    # One pass over the measured samples gives the state at all origins at once.
    def advance_measured(state: CompensatorState, inputs: tuple[Sample, Array]) -> tuple:
        sample, factor = inputs
        state, innovation = compensator.step(state, sample, step_s)
        return state, (state, factor * innovation)

    first = jax.tree.map(lambda array: array[0], test)
    _, measured = jax.lax.scan(advance_measured, compensator.init_state(first), (test, trust))
    states, innovations = jax.tree.map(lambda values: values[::every], measured)

    # From each origin the compensator hears the error that it predicts itself, sample by sample.
    def from_origin(
        origin: Array, state: CompensatorState, estimate: ErrorEstimate, innovation: Array
    ) -> tuple:
        def advance(carry: tuple, index: Array) -> tuple[tuple, Array]:
            state, estimate, innovation = carry
            increment = test.benchmark[index] - test.benchmark[jnp.maximum(index - 1, origin)]
            estimate = load_filter.advance(estimate, increment, step_s)
            error = estimate.error + innovation
            sample = jax.tree.map(lambda array: array[index], test)
            predicted = sample._replace(displacement=sample.benchmark + error)
            state, ahead = compensator.step(state, predicted, step_s)
            return (state, estimate.with_innovation(innovation), trust[index] * ahead), error

        # Beyond the end of the test the last sample is repeated; nobody reads what is predicted there.
        ahead = jnp.minimum(origin + jnp.arange(1, corrected + 1), count - 1)
        (_, estimate, _), errors = jax.lax.scan(advance, (state, estimate, innovation), ahead)
        return estimate, errors

    by_origin = jax.vmap(from_origin, in_axes=(0, 0, -1, 0), out_axes=-1)
    estimates, errors = by_origin(jnp.asarray(origins), states, estimates, innovations)
    return errors if corrected == horizon else jnp.concatenate([errors, filtered(estimates, corrected)])


RECORDS = 'records as hitchid.read("logs").records holds them'


@short_repr
class Channel(eqx.Module):
    """Grey-box model of one direction: benchmark, compensator for predictions, compensator for free run.

    Attributes:
        direction: direction of the command, lifting or lowering.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        dead_zone: dead zone of the command, in its unit.
        end_stop: mechanical end of the stroke, in the displacement's unit; None where none was met.
        benchmark: the model from commands to displacement.
        operating_range: ranges of the signals in the identification tests.
        compensator: predicts the benchmark's error from measured displacement; None for no correction.
        speed_compensator: corrects the benchmark in free run; None where it was not accepted.
        limits: limits of the displacement in free run; None for none.
        load_filter: estimates offset and load from measured displacement.
    """

    direction: str = eqx.field(static=True)
    sign: int = eqx.field(static=True)
    dead_zone: float
    end_stop: float | None
    benchmark: PhysicalModel
    operating_range: OperatingRange
    compensator: Compensator | None = None
    speed_compensator: SpeedCompensator | None = None
    limits: TravelLimits | None = None
    load_filter: LoadFilter = eqx.field(default_factory=LoadFilter.none)

    @double_precision
    def batch(
        self,
        records: Sequence[Record],
        initial: Sequence[float] | None = None,
        *,
        covariates: Sequence[str] | None = None,
    ) -> Batch:
        """Return records as a batch with this channel's dead zone, sign and end stop; see `Batch.of`.

        `covariates` names others than the benchmark's.
        """
        return Batch.of(
            checks.tuple_of(records, Record, "records", RECORDS),
            self.direction,
            dead_zone=self.dead_zone,
            sign=self.sign,
            end_stop=self.end_stop,
            initial=initial,
            covariates=self.benchmark.covariates if covariates is None else covariates,
        )

    @double_precision
    def simulate_benchmark(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the benchmark's free run from commands and initial displacement, shape [T, N]."""
        return self.limited(batch, self.benchmark.travel(batch))

    @double_precision
    def simulate(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the grey box's free run from commands and initial displacement, shape [T, N]."""
        if self.speed_compensator is None:
            return self.simulate_benchmark(batch)
        travel = simulate_compensated(
            self.speed_compensator,
            self.benchmark.travel(batch),
            batch.command,
            batch.initial,
            self._load(batch),
            batch.step_s,
        )
        return self.limited(batch, travel)

    @double_precision
    def simulate_closed_loop(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the free run with the compensator for predictions in closed loop, shape [T, N].

        Its own output replaces the measured displacement; this is the free run of Sun et al. 2025.
        """
        benchmark = self.simulate_benchmark(batch)
        if self.compensator is None:
            return benchmark
        time_s = jnp.broadcast_to(_clock(batch)[:, None], benchmark.T.shape)
        errors = free_run(self.compensator, time_s, batch.command.T, benchmark.T, batch.step_s)
        return benchmark + errors.T

    @double_precision
    def out_of_range(self, batch: Batch, displacement: Float[Array, "t n"]) -> Mapping[str, np.ndarray]:
        """Return where a simulation leaves the operating range of the identification tests.

        Args:
            batch: the simulated tests.
            displacement: simulated displacement, shape [T, N].

        Returns:
            `command`, `displacement` and `load` to a mask of the samples outside, shape [T, N] each.
        """
        signals = {
            "command": jnp.abs(batch.command),
            "displacement": displacement,
        }
        trusts = {name: getattr(self.operating_range, name).trust(values) for name, values in signals.items()}
        trusts["load"] = self.operating_range.load_trust(self._load(batch))[:, None]
        return {name: np.asarray((trust < 1) & batch.valid) for name, trust in trusts.items()}

    def _load(self, batch: Batch) -> Float[Array, "t c"]:
        return batch.load(self.benchmark.covariates)

    def limited(self, batch: Batch, travel: Float[Array, "t n"]) -> Float[Array, "t n"]:
        """Return the displacement of a travel, within the end stop and the limits, shape [T, N]."""
        if self.end_stop is not None:
            # A stroke that begins beyond the stop stays where it begins.
            max_travel = jnp.maximum(self.sign * (self.end_stop - batch.initial), 0.0)
            travel = jnp.minimum(travel, max_travel[:, None])
        displacement = batch.to_displacement(travel)
        return displacement if self.limits is None else self.limits.clip(displacement, batch.initial[:, None])

    @double_precision
    def predict(self, batch: Batch, horizons: tuple[int, ...], every: int = 1) -> Float[Array, "h t n"]:
        """Return the h-step-ahead predictions, from displacement measured up to h samples before.

        Near the start of a test, sample k < h is predicted from the initial displacement.

        Args:
            batch: tests.
            horizons: prediction horizons h, in samples.
            every: predictions start from every so many samples; those from other samples are NaN.

        Returns:
            Predictions, shape [len(horizons), T, N].
        """
        benchmark = self.simulate_benchmark(batch)
        time_s = jnp.broadcast_to(_clock(batch), benchmark.shape)
        tests = Sample(time_s, batch.command, benchmark, batch.displacement)
        trust = self.operating_range.trust(jnp.abs(batch.command), benchmark, self._load(batch)[:, None])
        return benchmark + predict_errors(
            self.load_filter, self.compensator, tests, trust, horizons, batch.step_s, every
        )


def _clock(batch: Batch) -> Float[Array, " n"]:
    return batch.step_s * jnp.arange(batch.command.shape[1])


def remove_padding(rows: Float[np.ndarray, "t n"], records: Sequence[Record]) -> list[np.ndarray]:
    """Return each test's row without its padding."""
    return [row[: len(record)] for row, record in zip(rows, records, strict=True)]


# Dead zones and thresholds of commands, in the units of logs.


def command_thresholds(
    channels: Mapping[str, Channel], model_units: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, CommandThreshold]:
    """Return direction to the threshold of its command; see `Hitch.command_thresholds`."""
    dead_zones = {direction: channel.dead_zone for direction, channel in channels.items()}
    thresholds = {}
    for direction, dead_zone in in_log_units(dead_zones, model_units, units).items():
        benchmark = channels[direction].benchmark
        hysteresis = benchmark.named_values().get("hysteresis", 0.0)
        thresholds[direction] = CommandThreshold(
            dead_zone, hysteresis * dead_zone, float(benchmark.dead_time_s)
        )
    return thresholds


def in_log_units(
    dead_zones: Mapping[str, float], model_units: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, float]:
    """Return direction to dead zone, from the model's units to those of logs where both are known.

    Raises:
        InputError: a unit is of another dimension than the model's.
    """
    converted = {}
    for direction, dead_zone in dead_zones.items():
        role = COMMAND[direction]
        convertible = role in model_units and role in units
        factor = conversion_factor(model_units[role], units[role], role) if convertible else 1.0
        converted[direction] = dead_zone * factor
    return converted
