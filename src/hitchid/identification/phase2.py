"""Phase 2: the benchmark is frozen and the compensator is trained on its error."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.progress import TYPICAL_ITERATIONS, ProgressCallback, ProgressUpdate
from hitchid.estimation.training import (
    AdamConfig,
    EpochCallback,
    TrainingHistory,
    every_nth,
    pad_to_batches,
    train,
)
from hitchid.identification.preparation import ChannelData
from hitchid.identification.speed_training import SpeedCompensatorConfig
from hitchid.model import Channel
from hitchid.model.load_filter import LoadFilter
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES, Compensator, Sample, measured_features
from hitchid.networks.lstm import Lstm
from hitchid.structures import Batch

MAX_STRETCHES = 1000  # sequences of one training, which bounds the time of an epoch


@dataclass(frozen=True)
class CompensatorConfig:
    """Settings of the compensator, Sun et al. 2025, sec. 2.2.3 and 2.3.3, and what the paper leaves open.

    Attributes:
        hidden: cells of the LSTM.
        window: features read before a prediction.
        adam: Adam and early stopping.
        free_run: of the compensator for free run; None for none.
    """

    hidden: int = 32
    window: int = 50
    adam: AdamConfig = field(default_factory=AdamConfig)
    free_run: SpeedCompensatorConfig | None = field(default_factory=SpeedCompensatorConfig)


_measured_features = jax.jit(measured_features, static_argnums=1)
_estimates = jax.jit(LoadFilter.estimates)


class Sequences(NamedTuple):
    """Stretches of twice the window, the second half of which is predicted.

    Attributes:
        features: scaled features, shape [C, 2 L, 10].
        valid: which samples exist, shape [C, 2 L].
        target: innovation / σ for the sample after each of the last L positions, shape [C, L].
        loss_mask: which targets exist, shape [C, L].
    """

    features: Float32[Array, "c w 10"]
    valid: Bool[Array, "c w"]
    target: Float32[Array, "c l"]
    loss_mask: Bool[Array, "c l"]


def with_compensator(
    channel: Channel,
    data: ChannelData,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: EpochCallback,
    checkpoints: Checkpoints,
) -> tuple[Channel, TrainingHistory]:
    """Train the compensator for predictions of a channel."""
    compensator, training_history = train_compensator(
        (data.training, channel.simulate_benchmark(data.training)),
        (data.validation, channel.simulate_benchmark(data.validation)),
        channel.load_filter,
        training,
        key,
        progress,
        checkpoints,
    )
    return replace(channel, compensator=compensator), training_history


def epoch_callback(progress: ProgressCallback, stage: str) -> EpochCallback:
    """Return a callback that reports epochs; early stopping leaves the total number unknown."""

    def show(number: int, training_loss: float, validation_loss: float) -> None:
        done = number / (number + TYPICAL_ITERATIONS)
        figures = {"training loss": training_loss, "validation loss": validation_loss}
        progress(ProgressUpdate(stage, done, f"epoch {number}", figures))

    return show


def train_compensator(
    training: tuple[Batch, Float[Array, "t n"]],
    validation: tuple[Batch, Float[Array, "v n"]],
    load_filter: LoadFilter,
    settings: CompensatorConfig,
    key: PRNGKeyArray,
    progress: EpochCallback | None = None,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[Compensator, TrainingHistory]:
    """Train a compensator on the errors of a frozen benchmark.

    Scaling comes from the training tests alone. Of more than 1000 stretches every m-th is taken:
    neighbours are alike. A prediction reads between L and 2 L features, because
    stretches share them, in training as later; see `CompensatorState`.
    Tests come with the displacement the benchmark gives for them, shape [T, N].

    Returns:
        The compensator of the epoch with the smallest validation loss, and both losses.
    """
    init_key, key = jax.random.split(key)
    compensator, sequences = untrained_compensator(
        *training, load_filter, settings, init_key, training[0].loss_mask
    )
    validation_sequences = _sequences(
        compensator, *_features(*validation, load_filter), np.asarray(validation[0].loss_mask)
    )
    sequences, validation_sequences = (
        pad_to_batches(every_nth(stretches, MAX_STRETCHES), settings.adam.batch)
        for stretches in (sequences, validation_sequences)
    )
    network, trace = train(
        compensator.network,
        squared_error,
        sequences,
        validation_sequences,
        settings.adam,
        key,
        progress,
        checkpoints,
    )
    trained = Compensator(
        network, compensator.centre, compensator.spread, compensator.error_step, settings.window
    )
    return trained, trace


def untrained_compensator(
    batch: Batch,
    benchmark: Float[Array, "t n"],
    load_filter: LoadFilter,
    settings: CompensatorConfig,
    key: PRNGKeyArray,
    loss_mask: Bool[Array, "t n"],
) -> tuple[Compensator, Sequences]:
    """Return an untrained compensator scaled to tests, and the stretches of these to train it on.

    Samples outside the mask are not scaled to, and give stretches without targets.
    """
    features, innovations = _features(batch, benchmark, load_filter)
    mask = np.asarray(loss_mask)
    rows = features[mask]
    spread = rows.std(axis=0)
    varies = spread > 1e-12 * np.maximum(1.0, np.abs(rows).max(axis=0))
    compensator = Compensator(
        network=Lstm.init(key, len(COMPENSATOR_FEATURES), settings.hidden),
        centre=jnp.asarray(rows.mean(axis=0)),
        spread=jnp.asarray(np.where(varies, spread, 1.0)),
        error_step=jnp.asarray(max(float(innovations[:, 1:][mask[:, 1:]].std()), np.finfo(np.float32).tiny)),
        window=settings.window,
    )
    return compensator, _sequences(compensator, features, innovations, np.asarray(batch.loss_mask), mask)


def _features(
    batch: Batch, benchmark: Float[Array, "t n"], load_filter: LoadFilter
) -> tuple[np.ndarray, np.ndarray]:
    """Return features, shape [T, N, 10], and innovations of the filter, shape [T, N]."""
    command, displacement = np.asarray(batch.command), np.asarray(batch.displacement)
    modelled = np.asarray(benchmark)
    time_s = np.broadcast_to(batch.step_s * np.arange(command.shape[1]), command.shape)
    samples = Sample(*(jnp.asarray(signal.T) for signal in (time_s, command, modelled, displacement)))
    _, features = _measured_features(samples, batch.step_s)
    before, _ = _estimates(load_filter, samples.benchmark, samples.displacement, batch.step_s)
    innovations = displacement - modelled - np.asarray(before.error).T
    return np.swapaxes(np.asarray(features), 0, 1), innovations


def _sequences(
    compensator: Compensator,
    features: np.ndarray,
    innovations: np.ndarray,
    loss_mask: np.ndarray,
    predicted_mask: np.ndarray | None = None,
) -> Sequences:
    """Cut tests into stretches of 2 L samples, L apart, the first beginning L before the test.

    Samples outside `predicted_mask`, by default outside `loss_mask`, are no targets.
    """
    window = compensator.window
    count = features.shape[1]
    stretches = -(-count // window)
    padding = ((0, 0), (window, stretches * window - count))
    scaled = np.pad(np.asarray(compensator.scale(jnp.asarray(features))), (*padding, (0, 0)))
    valid = np.pad(loss_mask, padding)
    is_target = valid if predicted_mask is None else valid & np.pad(predicted_mask, padding)
    targets = np.pad(innovations / float(compensator.error_step), padding).astype(np.float32)

    starts = window * np.arange(stretches)
    positions = starts[:, None] + np.arange(2 * window)
    # The prediction for sample k is made after reading sample k − 1, so targets lie one behind features.
    reading, predicted = positions - 1, positions[:, window:]
    target_mask = valid[:, predicted] & valid[:, predicted - 1]
    has_target = target_mask.any(axis=2)

    def select(array: np.ndarray) -> Array:
        return jax.device_put(array[has_target])

    return Sequences(
        features=select(scaled[:, np.maximum(reading, 0)]),
        valid=select(valid[:, np.maximum(reading, 0)] & (reading >= 0)),
        target=select(targets[:, predicted]),
        loss_mask=select(target_mask & is_target[:, predicted]),
    )


def squared_error(network: Lstm, sequences: Sequences) -> tuple[Array, Array]:
    window = sequences.target.shape[1]
    outputs = network.unroll(jnp.swapaxes(sequences.features, 0, 1), sequences.valid.T)
    residuals = (outputs[window:].T - sequences.target) * sequences.loss_mask
    return jnp.sum(residuals**2), jnp.sum(sequences.loss_mask)
