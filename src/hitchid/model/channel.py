"""One direction of a hitch: dead zone, benchmark, compensator, and the baselines fitted beside them."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.baselines import Arx, BlackBox
from hitchid.benchmark import Batch, Benchmark
from hitchid.compensator import Compensator, Sample, free_run, predicted_errors
from hitchid.record import Record


class Channel(eqx.Module):
    """A grey box for one direction: y = y_tf + ê.

    Attributes:
        mode: whose command it hears.
        direction: +1 where the displacement grows with the command, −1 where it falls.
        dead_zone: dead zone of the command, in its unit.
        end_stop: displacement the piston cannot pass, in the displacement's unit; None where none was met.
        benchmark: the transfer function.
        compensator: what predicts the benchmark's error; None leaves the benchmark alone.
        arx, black_box: baselines fitted on the same tests.
    """

    mode: str = eqx.field(static=True)
    direction: int = eqx.field(static=True)
    dead_zone: float = eqx.field(static=True)
    end_stop: float | None = eqx.field(static=True)
    benchmark: Benchmark
    compensator: Compensator | None = None
    arx: Arx | None = None
    black_box: BlackBox | None = None

    def batch(self, records: Sequence[Record], initial: Sequence[float] | None = None) -> Batch:
        """Lay records side by side as this channel hears them; see `Batch.of`."""
        return Batch.of(
            records,
            self.mode,
            dead_zone=self.dead_zone,
            direction=self.direction,
            end_stop=self.end_stop,
            initial=initial,
            load=self.benchmark.load,
        )

    def simulate_benchmark(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the benchmark's free run from commands and initial displacement, shape [T, N]."""
        travel = self.benchmark.travel(batch)
        if self.end_stop is not None:
            room = jnp.maximum(self.direction * (self.end_stop - batch.initial), 0.0)
            travel = jnp.minimum(travel, room[:, None])
        return batch.displaced(travel)

    def simulate(self, batch: Batch) -> Float[Array, "t n"]:
        """Return the grey box's free run from commands and initial displacement, shape [T, N]."""
        benchmark = self.simulate_benchmark(batch)
        if self.compensator is None:
            return benchmark
        time_s = jnp.broadcast_to(_clock(batch)[:, None], benchmark.T.shape)
        errors = free_run(self.compensator, time_s, batch.command.T, benchmark.T, batch.step_s)
        return benchmark + errors.T

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
        errors = predicted_errors(self.compensator, tests, batch.valid, horizons, batch.step_s)
        return benchmark + errors


def _clock(batch: Batch) -> Float[Array, " n"]:
    return batch.step_s * jnp.arange(batch.command.shape[1])


def unpadded(rows: Float[np.ndarray, "t n"], records: Sequence[Record]) -> list[np.ndarray]:
    """Return each test's row without its padding."""
    return [row[: len(record)] for row, record in zip(rows, records, strict=True)]
