"""The compensator: an LSTM over a window of features that predicts the benchmark's error.

Sun et al. 2025, sec. 2.2.3. The paper leaves open how the network is built; here it predicts the step the
error takes from its last known value, so that an untrained network is exactly persistence.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Float32, Int

from hitchid.networks.lstm import SINGLE, Hidden, Lstm

FEATURES = (
    "time",
    "command",
    "command_change",
    "benchmark",
    "benchmark_change",
    "displacement",
    "speed",
    "error_before",
    "error_change",
    "error_sum",
)


class Sample(NamedTuple):
    """What is known at one instant, each of any one shape [...].

    Attributes:
        time_s: time since the start of the test, s.
        command: effective command.
        benchmark: displacement the benchmark gives, y_tf.
        displacement: measured displacement, or the model's own where none is measured.
    """

    time_s: Float[Array, "*b"]
    command: Float[Array, "*b"]
    benchmark: Float[Array, "*b"]
    displacement: Float[Array, "*b"]


class Memory(NamedTuple):
    """What the features need of the past, each of shape [...].

    Attributes:
        last: the previous sample.
        error: e(i−1); error_before: e(i−2); error_sum: Ts Σ e up to i−1.
    """

    last: Sample
    error: Float[Array, "*b"]
    error_before: Float[Array, "*b"]
    error_sum: Float[Array, "*b"]

    @classmethod
    def at_rest(cls, first: Sample) -> "Memory":
        """Return the memory before the first sample of a test: nothing has moved, no error was made."""
        none = jnp.zeros_like(first.displacement)
        return cls(first, none, none, none)


def observe(memory: Memory, sample: Sample, step_s: float) -> tuple[Memory, Float[Array, "*b 10"]]:
    """Take in one sample and return the ten features of Sun et al. 2025, sec. 2.2.3, at it.

    x(i) = t, u, Δu, y_tf, Δy_tf, y, Δy/Ts, e(i−1), e(i−1) − e(i−2), Ts Σ e up to i, with e = y − y_tf.
    """
    error = sample.displacement - sample.benchmark
    total = memory.error_sum + step_s * error
    features = jnp.stack(
        [
            sample.time_s,
            sample.command,
            sample.command - memory.last.command,
            sample.benchmark,
            sample.benchmark - memory.last.benchmark,
            sample.displacement,
            (sample.displacement - memory.last.displacement) / step_s,
            memory.error,
            memory.error - memory.error_before,
            total,
        ],
        axis=-1,
    )
    return Memory(sample, error, memory.error, total), features


class Compensator(eqx.Module):
    """LSTM compensator with its scaling inside.

    ê(k) = e(k−1) + σ · (w · h(k) + b), where h(k) is the output of an LSTM that has read the scaled features
    up to x(k−1) of Sun et al. 2025, sec. 2.2.3, no fewer than L and no more than 2 L; see `Listening`.

    Attributes:
        network: LSTM and output layer.
        centre, spread: scaling of the features, fitted on training tests, shape [10].
        error_step: σ, the spread of e(k) − e(k−1) over the training tests, shape [].
        window: L, the fewest features read before a prediction.
    """

    network: Lstm
    centre: Float[Array, " 10"]
    spread: Float[Array, " 10"]
    error_step: Float[Array, ""]
    window: int = eqx.field(static=True)

    def scale(self, features: Float[Array, "*b 10"]) -> Float32[Array, "*b 10"]:
        """Return features in units of their spread over the training tests."""
        return ((features - self.centre) / self.spread).astype(SINGLE)

    def begin(self, first: Sample) -> "Listening":
        """Return what is carried before the first sample of a test, of any shape [b]."""
        blank = self.network.blank((*first.command.shape, 2))
        return Listening(Attention.at_rest(first), blank)

    def listen(
        self, listening: "Listening", sample: Sample, step_s: float
    ) -> tuple["Listening", Float[Array, "*b"]]:
        """Take in one sample of each of b tests.

        Returns:
            What is carried on, and the step σ (w · h + b) that the error takes to the next sample, in the
            displacement's unit, shape [b].
        """
        attention, scaled = self.hear(listening.attention, sample, step_s)
        hidden, step = self.answer(listening.hidden, attention.place, scaled)
        return Listening(attention, hidden), step

    def hear(
        self, attention: "Attention", sample: Sample, step_s: float
    ) -> tuple["Attention", Float32[Array, "*b 10"]]:
        """Take in one sample: what the features need of the past, and the scaled features."""
        memory, features = observe(attention.memory, sample, step_s)
        return Attention(memory, (attention.place + 1) % self.window), self.scale(features)

    def answer(
        self, hidden: Hidden, place: Int[Array, ""], scaled: Float32[Array, "*b 10"]
    ) -> tuple[Hidden, Float[Array, "*b"]]:
        """Let the network read scaled features; return its state and the step the error takes."""
        hidden = jax.tree.map(lambda pair: jnp.where(place == 0, _handed_over(pair), pair), hidden)
        hidden = self.network.read(hidden, scaled[..., None, :])
        output = self.network.output(jax.tree.map(lambda pair: pair[..., 0, :], hidden))
        return hidden, self.error_step * output.astype(self.error_step.dtype)


class Attention(NamedTuple):
    """The numbers a compensator carries from sample to sample.

    Attributes:
        memory: what the features need of the past.
        place: samples read, modulo L.
    """

    memory: Memory
    place: Int[Array, ""]

    @classmethod
    def at_rest(cls, first: Sample) -> "Attention":
        """Return what is carried before the first sample of a test."""
        return cls(Memory.at_rest(first), jnp.zeros((), jnp.int32))


class Listening(NamedTuple):
    """What a compensator carries from sample to sample.

    Two states of the LSTM: one answers, the other has begun to read up to L samples later. Every L samples
    the later one takes over and a blank one begins, so that a prediction has read L to 2 L samples (all there
    are near the start), as in training.

    Attributes:
        attention: numbers.
        hidden: the LSTM that answers and the one that follows, shape [..., 2, H].
    """

    attention: Attention
    hidden: Hidden


def _handed_over(pair: Float[Array, "*b 2 h"]) -> Float[Array, "*b 2 h"]:
    return jnp.stack([pair[..., 1, :], jnp.zeros_like(pair[..., 1, :])], axis=-2)


def measured_features(samples: Sample, step_s: float) -> tuple[Memory, Float[Array, "n *t 10"]]:
    """Return memory and features at every sample of measured tests.

    Args:
        samples: arrays of shape [N] or [N, T].
        step_s: sampling time, s.

    Returns:
        The memory after each sample, in arrays of that shape, and the features, shape [N, …, 10].
    """

    def advance(memory: Memory, sample: Sample) -> tuple[Memory, tuple[Memory, Array]]:
        memory, features = observe(memory, sample, step_s)
        return memory, (memory, features)

    first = jax.tree.map(lambda array: array[0], samples)
    _, stacked = jax.lax.scan(advance, Memory.at_rest(first), samples)
    return stacked


@eqx.filter_jit
def free_run(
    compensator: Compensator, time_s: Array, command: Array, benchmark: Array, step_s: float
) -> Float[Array, "n t"]:
    """Return the errors ê the compensator gives when it hears only itself: y = y_tf + ê, ê(0) = 0.

    Args:
        compensator: a trained compensator.
        time_s, command, benchmark: time since start, effective command, benchmark output, shape [N, T].
        step_s: sampling time, s.
    """
    known = Sample(time_s, command, benchmark, benchmark)
    first = jax.tree.map(lambda array: array[0], known)

    def advance(carry: tuple[Listening, Array], sample: Sample) -> tuple[tuple, Array]:
        listening, error = carry
        own = sample._replace(displacement=sample.benchmark + error)
        listening, step = compensator.listen(listening, own, step_s)
        return (listening, error + step), error

    _, errors = jax.lax.scan(advance, (compensator.begin(first), jnp.zeros_like(command[0])), known)
    return errors


@eqx.filter_jit
def predicted_errors(
    compensator: Compensator | None,
    tests: Sample,
    trust: Float[Array, "t n"],
    horizons: tuple[int, ...],
    step_s: float,
) -> Float[Array, "h t n"]:
    """Return ê at every sample, predicted from what was measured h samples before and earlier, for each h.

    Near the start of a test, sample k < h is predicted from the initial displacement. Without a compensator
    the last known error stands.

    Args:
        compensator: a trained compensator, or None.
        tests: arrays of shape [T, N].
        trust: factor on the compensator's steps, 0 to 1, shape [T, N].
        horizons: the h asked for, in samples.
        step_s: sampling time, s.
    """

    def of_test(given: tuple[Sample, Array]) -> Float[Array, "h n"]:
        test, trusted = given
        error = test.displacement - test.benchmark
        if compensator is None:
            ahead = jnp.broadcast_to(error, (max(horizons), error.size))
        else:
            ahead = rolled_out(compensator, test, trusted, max(horizons), step_s)
        # ahead[h − 1, i] is for sample i + h; the origin of the first samples is sample 0.
        sample = jnp.arange(error.size)
        rows = []
        for horizon in horizons:
            steps = jnp.minimum(sample, horizon)
            rows.append(jnp.where(sample > 0, ahead[jnp.maximum(steps - 1, 0), sample - steps], 0.0))
        return jnp.stack(rows)

    return jnp.moveaxis(jax.lax.map(of_test, (tests, trust)), 1, 0)


def rolled_out(
    compensator: Compensator, test: Sample, trust: Float[Array, " n"], horizon: int, step_s: float
) -> Float[Array, "h n"]:
    """Return ê(i+h) for h = 1 … horizon from every origin i of one measured test.

    Up to the origin the LSTM reads measured features; beyond it, features made of the model's own output.

    Args:
        compensator: a trained compensator.
        test: one test, arrays of shape [N].
        trust: factor on the compensator's steps, shape [N].
        horizon: steps to look ahead.
        step_s: sampling time, s.
    """
    count = trust.shape[0]

    def measured(listening: Listening, sample: Sample) -> tuple[Listening, tuple[Listening, Array]]:
        listening, step = compensator.listen(listening, sample, step_s)
        return listening, (listening, step)

    first = jax.tree.map(lambda array: array[0], test)
    _, (origins, steps) = jax.lax.scan(measured, compensator.begin(first), test)

    def from_origin(listening: Listening, error: Array, origin: Array) -> Float[Array, " h"]:
        def advance(carry: tuple[Listening, Array], ahead: Array) -> tuple[tuple, Array]:
            listening, error = carry
            index = jnp.minimum(origin + ahead, count - 1)
            known = jax.tree.map(lambda array: array[index], test)
            own = known._replace(displacement=known.benchmark + error)
            listening, step = compensator.listen(listening, own, step_s)
            return (listening, error + trust[index] * step), error

        return jax.lax.scan(advance, (listening, error), jnp.arange(1, horizon + 1))[1]

    errors = test.displacement - test.benchmark + trust * steps
    return jax.vmap(from_origin, out_axes=1)(origins, errors, jnp.arange(count))
