"""Error compensator: an LSTM over a window of features that predicts the error of the benchmark.

Sun et al. 2025, sec. 2.2.3. The paper does not specify the architecture; here the network predicts the
increment of the error from its last value, so that an untrained network predicts a constant error.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Float32, Int

from hitchid.networks.lstm import SINGLE, Lstm, LstmState

MAX_HORIZON = 100  # samples after a measurement, at most, that a compensator corrects; chosen: 1 s at 100 Hz
COMPENSATOR_FEATURES = (
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
    """Signals at one sample, all of one shape [...].

    Attributes:
        time_s: time since the start of the test, s.
        command: effective command.
        benchmark: output of the benchmark, y_tf, in the displacement's unit.
        displacement: measured displacement, or the model's output where none is measured.
    """

    time_s: Float[Array, "*b"]
    command: Float[Array, "*b"]
    benchmark: Float[Array, "*b"]
    displacement: Float[Array, "*b"]


class FeatureHistory(NamedTuple):
    """Past values from which the features are computed, each of shape [...].

    Attributes:
        last_sample: the previous sample.
        error, error_before, error_sum: e(i−1), e(i−2) and Ts Σ e up to i−1.
    """

    last_sample: Sample
    error: Float[Array, "*b"]
    error_before: Float[Array, "*b"]
    error_sum: Float[Array, "*b"]

    @classmethod
    def at_rest(cls, first: Sample) -> "FeatureHistory":
        """Return the history before the first sample of a test: at rest, without error."""
        zeros = jnp.zeros_like(first.displacement)
        return cls(first, zeros, zeros, zeros)


def compute_features(
    history: FeatureHistory, sample: Sample, step_s: float
) -> tuple[FeatureHistory, Float[Array, "*b 10"]]:
    """Return the updated history and the ten features of Sun et al. 2025, sec. 2.2.3, at one sample.

    x(i) = t, u, Δu, y_tf, Δy_tf, y, Δy/Ts, e(i−1), e(i−1) − e(i−2), Ts Σ e up to i, with e = y − y_tf.
    """
    error = sample.displacement - sample.benchmark
    error_sum = history.error_sum + step_s * error
    features = jnp.stack(
        [
            sample.time_s,
            sample.command,
            sample.command - history.last_sample.command,
            sample.benchmark,
            sample.benchmark - history.last_sample.benchmark,
            sample.displacement,
            (sample.displacement - history.last_sample.displacement) / step_s,
            history.error,
            history.error - history.error_before,
            error_sum,
        ],
        axis=-1,
    )
    return FeatureHistory(sample, error, history.error, error_sum), features


class Compensator(eqx.Module):
    """LSTM compensator including the scaling of its inputs and output.

    ê(k) = e(k−1) + σ · (w · h(k) + b), where h(k) is the hidden state of an LSTM after the last L to 2 L
    samples of scaled features up to x(k−1) (Sun et al. 2025, sec. 2.2.3); see `CompensatorState`.

    Attributes:
        network: LSTM and output layer.
        centre, spread: scaling of the features, fitted on training tests, shape [10].
        error_step: σ, the spread of e(k) − e(k−1) over the training tests, shape [].
        window: L, the minimum number of samples that a prediction is based on.
        max_horizon: samples after a measurement that are corrected; the farther ahead, the more it reads its
            own output, for which it was not trained.
    """

    network: Lstm
    centre: Float[Array, " 10"]
    spread: Float[Array, " 10"]
    error_step: Float[Array, ""]
    window: int = eqx.field(static=True)
    max_horizon: int = eqx.field(static=True, default=MAX_HORIZON)

    def scale(self, features: Float[Array, "*b 10"]) -> Float32[Array, "*b 10"]:
        """Return features in units of their spread over the training tests."""
        return ((features - self.centre) / self.spread).astype(SINGLE)

    def init_state(self, first: Sample) -> "CompensatorState":
        """Return the state before the first sample of tests of any shape [b]."""
        lstm_state = self.network.zero_state((*first.command.shape, 2))
        return CompensatorState(FeatureState.at_rest(first), lstm_state)

    def step(
        self, state: "CompensatorState", sample: Sample, step_s: float
    ) -> tuple["CompensatorState", Float[Array, "*b"]]:
        """Advance by one sample of each of b tests.

        Returns:
            The next state, and the increment σ (w · h + b) of the error to the next sample, in the
            displacement's unit, shape [b].
        """
        feature_state, scaled_features = self.update_features(state.feature_state, sample, step_s)
        hidden, increment = self.predict_increment(
            state.hidden, feature_state.index_in_window, scaled_features
        )
        return CompensatorState(feature_state, hidden), increment

    def update_features(
        self, feature_state: "FeatureState", sample: Sample, step_s: float
    ) -> tuple["FeatureState", Float32[Array, "*b 10"]]:
        """Return the next feature state and the scaled features at one sample."""
        history, features = compute_features(feature_state.history, sample, step_s)
        return FeatureState(history, (feature_state.index_in_window + 1) % self.window), self.scale(features)

    def predict_increment(
        self, hidden: LstmState, index_in_window: Int[Array, ""], scaled_features: Float32[Array, "*b 10"]
    ) -> tuple[LstmState, Float[Array, "*b"]]:
        """Return the next state of the LSTM and the increment of the error to the next sample."""
        # The windows rotate before the input is read, as in training.
        hidden = jax.tree.map(
            lambda pair: jnp.where(index_in_window == 0, _rotate_windows(pair), pair), hidden
        )
        hidden = self.network.step(hidden, scaled_features[..., None, :])
        output = self.network.output(jax.tree.map(lambda pair: pair[..., 0, :], hidden))
        return hidden, self.error_step * output.astype(self.error_step.dtype)


class FeatureState(NamedTuple):
    """State of the feature computation of a compensator.

    Attributes:
        history: past values from which the features are computed.
        index_in_window: number of samples processed, modulo L.
    """

    history: FeatureHistory
    index_in_window: Int[Array, ""]

    @classmethod
    def at_rest(cls, first: Sample) -> "FeatureState":
        """Return the state before the first sample of a test."""
        return cls(FeatureHistory.at_rest(first), jnp.zeros((), jnp.int32))


class CompensatorState(NamedTuple):
    """State of a compensator: features and two states of one LSTM with staggered windows.

    The first state gives the prediction; the second starts up to L samples later. Every L samples the second
    replaces the first and a zero state replaces the second, so that a prediction is based on the last L to
    2 L samples (on all samples near the start of a test), as in training.

    Attributes:
        feature_state: state of the feature computation.
        hidden: LSTM states of the current and of the next window, shape [..., 2, H].
    """

    feature_state: FeatureState
    hidden: LstmState


def _rotate_windows(pair: Float[Array, "*b 2 h"]) -> Float[Array, "*b 2 h"]:
    return jnp.stack([pair[..., 1, :], jnp.zeros_like(pair[..., 1, :])], axis=-2)


def measured_features(samples: Sample, step_s: float) -> tuple[FeatureHistory, Float[Array, "n *t 10"]]:
    """Return history and features at every sample of measured tests, of shape [N] or [N, T]."""

    def advance(
        history: FeatureHistory, sample: Sample
    ) -> tuple[FeatureHistory, tuple[FeatureHistory, Array]]:
        history, features = compute_features(history, sample, step_s)
        return history, (history, features)

    first = jax.tree.map(lambda array: array[0], samples)
    _, histories_and_features = jax.lax.scan(advance, FeatureHistory.at_rest(first), samples)
    return histories_and_features


@eqx.filter_jit
def free_run(
    compensator: Compensator, time_s: Array, command: Array, benchmark: Array, step_s: float
) -> Float[Array, "n t"]:
    """Return the errors ê of the compensator in closed loop on its own output: y = y_tf + ê, ê(0) = 0."""
    samples = Sample(time_s, command, benchmark, benchmark)
    first = jax.tree.map(lambda array: array[0], samples)

    def advance(carry: tuple[CompensatorState, Array], sample: Sample) -> tuple[tuple, Array]:
        state, error = carry
        simulated_sample = sample._replace(displacement=sample.benchmark + error)
        state, increment = compensator.step(state, simulated_sample, step_s)
        return (state, error + increment), error

    _, errors = jax.lax.scan(advance, (compensator.init_state(first), jnp.zeros_like(command[0])), samples)
    return errors
