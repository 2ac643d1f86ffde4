"""One direction of a hitch: dead zone, benchmark, compensators, and the baselines fitted beside them."""

from collections.abc import Mapping, Sequence
from typing import Optional

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.baselines.autoregression import Arx
from hitchid.baselines.black_box import BlackBox
from hitchid.baselines.narx import Narx
from hitchid.data.record import Record
from hitchid.model.limits import TravelLimits
from hitchid.networks.error_compensator import Compensator, Sample, free_run, predict_errors
from hitchid.networks.operating_range import OperatingRange
from hitchid.networks.speed_compensator import SpeedCompensator, simulate_compensated
from hitchid.structures import Batch, PhysicalModel

RECORDS = 'records as hitchid.read("logs").records holds them'


class Channel(eqx.Module):
    """A grey box for one direction: a benchmark, a compensator for predictions and one for free run.

    Attributes:
        direction: whose command it hears.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        dead_zone: dead zone of the command, in its unit.
        end_stop: displacement the piston cannot pass, in the displacement's unit; None where none was met.
        limits: between what displacements a free run is held; None in models that know none.
        benchmark: the model from commands to displacement.
        compensator: predicts the benchmark's error from what was measured before; None leaves it alone.
        speed_compensator: corrects the benchmark in free run; None where it did not prove itself.
        envelope: what the identification tests covered.
        arx, narx, black_box: baselines fitted on the same tests.
        paper: the method of Sun et al. 2025 fitted on the same tests, for comparison: a transfer function,
            and a compensator that in free run hears itself; None where this channel is that.
    """

    direction: str = eqx.field(static=True)
    sign: int = eqx.field(static=True)
    dead_zone: float = eqx.field(static=True)
    end_stop: float | None = eqx.field(static=True)
    benchmark: PhysicalModel
    compensator: Compensator | None = None
    speed_compensator: SpeedCompensator | None = None
    envelope: OperatingRange | None = None
    arx: Arx | None = None
    narx: Narx | None = None
    black_box: BlackBox | None = None
    paper: Optional["Channel"] = None
    limits: TravelLimits | None = eqx.field(static=True, default=None)

    @double_precision
    def batch(self, records: Sequence[Record], initial: Sequence[float] | None = None) -> Batch:
        """Lay records side by side as this channel hears them; see `Batch.of`."""
        return Batch.of(
            checks.tuple_of(records, Record, "records", RECORDS),
            self.direction,
            dead_zone=self.dead_zone,
            sign=self.sign,
            end_stop=self.end_stop,
            initial=initial,
            covariate=self.benchmark.covariate,
        )

    @double_precision
    def simulate_benchmark(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the benchmark's free run from commands and initial displacement, shape [T, N]."""
        return self._to_displacement(batch, self.benchmark.travel(batch))

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
            batch.covariate,
        )
        return self._to_displacement(batch, travel)

    @double_precision
    def simulate_closed_loop(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the free run of the compensator for predictions, which hears itself, shape [T, N].

        This is what the method of Sun et al. 2025 gives where nothing is measured.
        """
        benchmark = self.simulate_benchmark(batch)
        if self.compensator is None:
            return benchmark
        time_s = jnp.broadcast_to(_clock(batch)[:, None], benchmark.T.shape)
        errors = free_run(self.compensator, time_s, batch.command.T, benchmark.T, batch.step_s)
        return benchmark + errors.T

    @double_precision
    def out_of_range(self, batch: Batch, displacement: Float[Array, "t n"]) -> Mapping[str, np.ndarray]:
        """Tell where a simulation leaves what the identification tests covered.

        Args:
            batch: what was simulated.
            displacement: the result, shape [T, N].

        Returns:
            `command`, `displacement` and `load` to whether each sample is outside, shape [T, N].
        """
        if self.envelope is None:
            return {}
        signals = {
            "command": jnp.abs(batch.command),
            "displacement": displacement,
            "load": batch.covariate[:, None],
        }
        return {
            name: np.asarray((getattr(self.envelope, name).trust(values) < 1) & batch.valid)
            for name, values in signals.items()
        }

    def _to_displacement(self, batch: Batch, travel: Float[Array, "t n"]) -> Float[Array, "t n"]:
        """Return the displacement that belongs to a travel, no farther than the end stop and the limits."""
        if self.end_stop is not None:
            max_travel = jnp.maximum(self.sign * (self.end_stop - batch.initial), 0.0)
            travel = jnp.minimum(travel, max_travel[:, None])
        displacement = batch.to_displacement(travel)
        return displacement if self.limits is None else self.limits.clip(displacement, batch.initial[:, None])

    @double_precision
    def predict(self, batch: Batch, horizons: tuple[int, ...]) -> Float[Array, "h t n"]:
        """Return predictions that may use the measured displacement up to h samples before.

        Near the start of a test, sample k < h is predicted from the initial displacement.

        Args:
            batch: tests.
            horizons: the h asked for, in samples.

        Returns:
            Predictions, shape [len(horizons), T, N].
        """
        benchmark = self.simulate_benchmark(batch)
        time_s = jnp.broadcast_to(_clock(batch), benchmark.shape)
        tests = Sample(time_s, batch.command, benchmark, batch.displacement)
        trust = jnp.ones_like(benchmark)
        if self.envelope is not None:
            trust = self.envelope.trust(jnp.abs(batch.command), benchmark, batch.covariate[:, None])
        return benchmark + predict_errors(self.compensator, tests, trust, horizons, batch.step_s)


def _clock(batch: Batch) -> Float[Array, " n"]:
    return batch.step_s * jnp.arange(batch.command.shape[1])


def remove_padding(rows: Float[np.ndarray, "t n"], records: Sequence[Record]) -> list[np.ndarray]:
    """Return each test's row without its padding."""
    return [row[: len(record)] for row, record in zip(rows, records, strict=True)]
