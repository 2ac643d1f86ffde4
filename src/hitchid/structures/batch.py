"""Tests of unequal length in one set of arrays, padded and masked."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid._support.records import short_repr
from hitchid.logs.kinds import effective_command
from hitchid.logs.record import Record

MIN_PADDED_LENGTH, MIN_PADDED_TESTS = 256, 4  # samples, tests; smaller programs cost as much to compile
# Of the tests on a coarse clock, see `Batch.coarse`; chosen for speed.
COARSE_SAMPLES, COARSE_TOTAL, FEWEST_COARSE_SAMPLES = 2048, 32_768, 256
REST_SAMPLES = 50  # samples: their mean has a seventh of the sensor's noise
BY_TEST = (  # arrays of a batch with a row for each test
    "command",
    "raw_command",
    "dead_zone",
    "displacement",
    "valid",
    "loss_mask",
    "initial",
    "covariates",
)
STOP_FRACTION = 0.01  # share of the way to the end stop that is left where a sample counts as at it


@short_repr
class Batch(eqx.Module):
    """Tests of one direction, padded to one length.

    Attributes:
        command: effective command, shape [T, N].
        raw_command: the command as logged, shape [T, N].
        dead_zone: dead zone of the command, in its unit, shape [T].
        displacement: measured displacement, shape [T, N].
        valid: which samples exist, shape [T, N].
        loss_mask: which samples errors are taken over (those before an end stop is met), shape [T, N].
        initial: displacement before motion, shape [T].
        covariates: further measured inputs before motion, in the order of their names, shape [T, C].
        step_s: sampling time, s.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        covariate_names: names of the covariates.
    """

    command: Float[Array, "t n"]
    raw_command: Float[Array, "t n"]
    dead_zone: Float[Array, " t"]
    displacement: Float[Array, "t n"]
    valid: Bool[Array, "t n"]
    loss_mask: Bool[Array, "t n"]
    initial: Float[Array, " t"]
    covariates: Float[Array, "t c"]
    step_s: float
    sign: int
    covariate_names: tuple[str, ...] = eqx.field(default=(), static=True)

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        direction: str,
        *,
        dead_zone: float,
        sign: int,
        end_stop: float | None = None,
        initial: Sequence[float] | None = None,
        covariates: Sequence[str] = (),
    ) -> "Batch":
        """Stack records, padded so that like shapes compile once.

        The padded length is a power of two, 256 or more, or one and a half of it.

        Args:
            records: tests of one clock.
            direction: whose command counts.
            dead_zone: dead zone of that command, in its unit.
            sign: +1 where the displacement grows with the command, −1 where it falls.
            end_stop: displacement at which the piston meets its end stop, None where it never did.
            initial: displacement before motion; by default found by `mean_before_motion`.
            covariates: names of further measured inputs, whose means before motion are used.

        Raises:
            InputError: a record lacks a covariate.
        """
        for record in records:
            record.require(covariates)
        commands = [effective_command(record.command(direction), dead_zone) for record in records]
        displacements = [record.displacement for record in records]
        if initial is None:
            initial = [mean_before_motion(x, u) for x, u in zip(displacements, commands, strict=True)]
        means = [
            [mean_before_motion(record.signals[name], command) for name in covariates]
            for record, command in zip(records, commands, strict=True)
        ]
        loss_masks = [before_end_stop(x, sign, end_stop) for x in displacements]
        width = padded_length(max(map(len, records)))

        def stack(rows: Sequence[np.ndarray], dtype: type) -> Array:
            padded = np.zeros((len(rows), width), dtype=dtype)
            for row, samples in zip(padded, rows, strict=True):
                row[: len(samples)] = samples
            return jax.device_put(padded)

        return cls(
            command=stack(commands, np.float64),
            raw_command=stack([record.command(direction) for record in records], np.float64),
            dead_zone=jnp.full(len(records), dead_zone, dtype=np.float64),
            displacement=stack(displacements, np.float64),
            valid=stack([np.ones(len(record), dtype=bool) for record in records], np.bool_),
            loss_mask=stack(loss_masks, np.bool_),
            initial=jnp.asarray(np.asarray(initial, dtype=np.float64)),
            covariates=jnp.asarray(np.array(means, dtype=np.float64).reshape(len(records), -1)),
            step_s=records[0].step_s,
            sign=sign,
            covariate_names=tuple(covariates),
        )

    @property
    def travel(self) -> Float[Array, "t n"]:
        """Displacement away from the start, positive the way the command drives, shape [T, N]."""
        return self.sign * (self.displacement - self.initial[:, None])

    def to_displacement(self, travel: Float[Array, "t n"]) -> Float[Array, "t n"]:
        """Return the displacement that belongs to a travel; the inverse of `travel`."""
        return self.initial[:, None] + self.sign * travel

    def load(self, covariates: Sequence[str]) -> Float[Array, "t c"]:
        """Return some of the covariates of each test, in their order; a column of zeros for none."""
        if not covariates:
            return jnp.zeros((self.initial.shape[0], 1), self.initial.dtype)
        return self.covariates[:, np.array([self.covariate_names.index(name) for name in covariates])]

    def map_tests(
        self, function: Callable[["Batch", Array], Array], *rows: Float[Array, "t *b"]
    ) -> Float[Array, "t *d"]:
        """Return a function of each test, as a batch of one, and of its row of each array, stacked."""

        def of_batch(batch: "Batch") -> list:
            return [getattr(batch, name) for name in BY_TEST]

        def of_test(arrays: list[Array], *row: Array) -> Array:
            return function(eqx.tree_at(of_batch, self, [array[None] for array in arrays]), *row)

        return jax.vmap(of_test)(of_batch(self), *rows)

    def with_dead_zones(self, dead_zone: Float[Array, " t"]) -> "Batch":
        """Return the tests behind another dead zone, in the command's unit."""
        excess = jnp.maximum(jnp.abs(self.raw_command) - dead_zone[:, None], 0.0)
        return eqx.tree_at(
            lambda batch: (batch.command, batch.dead_zone),
            self,
            (jnp.sign(self.raw_command) * excess, dead_zone),
        )

    def with_dead_zone(self, dead_zone: float) -> "Batch":
        """Return the tests behind another dead zone, the same for all, in the command's unit."""
        return self.with_dead_zones(jnp.full_like(self.dead_zone, dead_zone))

    def masked(self, loss_mask: Bool[Array, "t n"]) -> "Batch":
        """Return the tests with errors taken over fewer samples."""
        return eqx.tree_at(lambda batch: batch.loss_mask, self, self.loss_mask & loss_mask)

    def decimate(self, samples: int) -> "Batch":
        """Return the tests on a coarser clock, with no more than so many samples each.

        A command is the mean over its new, longer interval, so that its integral stays.

        Args:
            samples: largest number of samples, that of the padding included.
        """
        width = self.command.shape[1]
        step = -(-width // samples)
        if step == 1:
            return self
        blocks = -(-width // step)

        def mean(array: Float[Array, "t n"]) -> Float[Array, "t m"]:
            padded = jnp.pad(array, ((0, 0), (0, blocks * step - width)), mode="edge")
            return padded.reshape(-1, blocks, step).mean(axis=2)

        return Batch(
            command=mean(self.command),
            raw_command=mean(self.raw_command),
            dead_zone=self.dead_zone,
            displacement=self.displacement[:, ::step],
            valid=self.valid[:, ::step],
            loss_mask=self.loss_mask[:, ::step],
            initial=self.initial,
            covariates=self.covariates,
            step_s=step * self.step_s,
            sign=self.sign,
            covariate_names=self.covariate_names,
        )

    def coarse(self) -> "Batch":
        """Return the tests on a clock for fits that are compared, or that others start from.

        At most 2048 samples a test; of many tests as many fewer as keep 32 768 in all, but for 256 a test:
        what a campaign determines grows with its tests, not with their samples.
        """
        samples = max(COARSE_TOTAL // self.command.shape[0], FEWEST_COARSE_SAMPLES)
        return self.decimate(min(samples, COARSE_SAMPLES))

    def pad_batch(self) -> "Batch":
        """Return the tests padded with tests of no weight, so that like numbers compile once.

        The number of tests becomes four, eight, twelve, sixteen, and so on as lengths do.
        """
        tests = self.command.shape[0]
        padding_tests = _bucket(tests, MIN_PADDED_TESTS) - tests
        if not padding_tests:
            return self
        padded = self.take([*range(tests), *[tests - 1] * padding_tests])
        return padded.masked(jnp.arange(padded.command.shape[0])[:, None] < tests)

    def take(self, indices: Sequence[int]) -> "Batch":
        """Return some of the tests."""
        rows = np.asarray(indices, dtype=np.int64)
        tests, static_fields = eqx.partition(self, eqx.is_array)
        return eqx.combine(
            jax.tree.map(lambda array: jax.device_put(np.asarray(array)[rows]), tests), static_fields
        )


def padded_length(samples: int) -> int:
    """Return the length that so many samples are padded to, so that like shapes compile once."""
    return _bucket(samples, MIN_PADDED_LENGTH)


def _bucket(count: int, smallest: int) -> int:
    """Return the least number not below a count of those that are `smallest` doubled, or that and its
    half."""
    size = smallest
    while size < count:
        if size > smallest and count <= size + size // 2:
            return size + size // 2
        size *= 2
    return size


def mean_before_motion(samples: np.ndarray, effective: np.ndarray) -> float:
    """Return the mean of the first samples before motion: up to the first effective command, at most 50.

    The sample at which a command first becomes effective still shows the piston at rest.

    Args:
        samples: a measured signal, shape [N].
        effective: effective command, shape [N].
    """
    active_samples = np.flatnonzero(effective)
    at_rest = int(active_samples[0]) + 1 if active_samples.size else samples.size
    return float(np.mean(samples[: min(at_rest, REST_SAMPLES)]))


def before_end_stop(displacement: np.ndarray, sign: int, end_stop: float | None) -> np.ndarray:
    """Return which samples come before the piston is within 1 % of its way to the end stop, shape [N]."""
    loss_mask = np.ones(displacement.size, dtype=bool)
    if end_stop is not None:
        remaining_travel = sign * (end_stop - displacement)
        at_stop = (
            np.flatnonzero(remaining_travel <= STOP_FRACTION * remaining_travel[0])
            if remaining_travel[0] > 0
            else np.array([0])
        )
        loss_mask[at_stop[0] if at_stop.size else displacement.size :] = False
    return loss_mask


# Division of the identification tests into training and validation tests.

VALIDATION_EVERY = 4  # chosen: every fourth test chooses orders and stops trainings
VALIDATION_FRACTION = 0.25  # share of one test alone that does


def validation_rows(tests: int) -> list[int]:
    """Return the positions of the validation tests: every fourth, of two or three tests the last."""
    return list(range(VALIDATION_EVERY - 1, tests, VALIDATION_EVERY)) or [tests - 1]


def validation_mask(batch: Batch) -> Bool[Array, "t n"]:
    """Return which samples of the loss mask validate: all of the validation tests, of one test the last
    quarter."""
    if len(batch.command) == 1:
        cumulative_count = jnp.cumsum(batch.loss_mask, axis=1)
        return batch.loss_mask & (cumulative_count > (1 - VALIDATION_FRACTION) * cumulative_count[:, -1:])
    is_validation = np.isin(np.arange(len(batch.command)), validation_rows(len(batch.command)))
    return batch.loss_mask & is_validation[:, None]


def split_validation(batch: Batch) -> tuple[Batch, Batch, list[int]]:
    """Return training and validation tests, and the positions of the latter.

    One test alone is both, with errors taken over different samples.
    """
    tests = len(batch.command)
    rows, mask = validation_rows(tests), validation_mask(batch)
    if tests == 1:
        return batch.masked(~mask), batch.masked(mask), rows
    return batch.take([row for row in range(tests) if row not in rows]), batch.take(rows), rows
