"""Phase 2: the benchmark is frozen and the compensator learns its error by gradient descent."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, PRNGKeyArray

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid.identification.descent import Descent, DescentTrace, Progress, descend, evenly, filled
from hitchid.identification.rollouts import Rollouts
from hitchid.networks.error_compensator import FEATURES, Compensator, Sample, measured_features
from hitchid.networks.lstm import Lstm
from hitchid.structures import Batch

MOST_STRETCHES = 1000


@dataclass(frozen=True)
class Training:
    """Settings of the compensator, Sun et al. 2025, sec. 2.2.3 and 2.3.3, and what the paper leaves open.

    Attributes:
        hidden: cells of the LSTM.
        window: features read before a prediction.
        descent: Adam and early stopping.
        rollouts: of the compensator for free run; None for none.
        baselines: whether the baselines are fitted beside it.
    """

    hidden: int = 32
    window: int = 50
    descent: Descent = field(default_factory=Descent)
    rollouts: Rollouts | None = field(default_factory=Rollouts)
    baselines: bool = True


_measured_features = jax.jit(measured_features, static_argnums=1)


class Sequences(NamedTuple):
    """Stretches of twice the window, the second half of which is predicted.

    Attributes:
        features: scaled features, shape [C, 2 L, 10].
        valid: which samples exist, shape [C, 2 L].
        target: (e(k) − e(k−1)) / σ for the sample after each of the last L positions, shape [C, L].
        counted: which targets exist, shape [C, L].
    """

    features: Float32[Array, "c w 10"]
    valid: Bool[Array, "c w"]
    target: Float32[Array, "c l"]
    counted: Bool[Array, "c l"]


def train_compensator(
    training: tuple[Batch, Float[Array, "t n"]],
    validation: tuple[Batch, Float[Array, "v n"]],
    settings: Training,
    key: PRNGKeyArray,
    progress: Progress | None = None,
    kept: Checkpoints = NOWHERE,
) -> tuple[Compensator, DescentTrace]:
    """Train a compensator on the errors of a frozen benchmark.

    Scaling comes from the training tests alone. Of more than 1000 stretches every m-th is taken: neighbours
    say the same, and time goes with their number. A prediction reads between L and 2 L features, because
    stretches share them, in training as later; see `Listening`.

    Args:
        training, validation: tests and the displacement the benchmark gives for them, shape [T, N].
        settings: size, window, optimiser.
        key: initial weights and shuffling.
        progress, kept: see `descend`.

    Returns:
        The compensator of the epoch with the smallest validation loss, and both losses.
    """
    init_key, key = jax.random.split(key)
    features, errors = _features(*training)
    batch = training[0]
    seen = np.asarray(batch.counted)
    rows = features[seen]
    moved = np.diff(errors, axis=1)[seen[:, 1:]]
    compensator = Compensator(
        network=Lstm.fresh(init_key, len(FEATURES), settings.hidden),
        centre=jnp.asarray(rows.mean(axis=0)),
        spread=jnp.asarray(_spread(rows)),
        error_step=jnp.asarray(max(float(moved.std()), np.finfo(np.float32).tiny)),
        window=settings.window,
    )
    sequences = _sequences(compensator, features, errors, batch)
    held = _sequences(compensator, *_features(*validation), validation[0])
    sequences, held = (
        filled(evenly(each, MOST_STRETCHES), settings.descent.batch) for each in (sequences, held)
    )
    network, trace = descend(
        compensator.network, _squared_error, sequences, held, settings.descent, key, progress, kept
    )
    trained = Compensator(
        network, compensator.centre, compensator.spread, compensator.error_step, settings.window
    )
    return trained, trace


def _features(batch: Batch, benchmark: Float[Array, "t n"]) -> tuple[np.ndarray, np.ndarray]:
    """Return features, shape [T, N, 10], and errors, shape [T, N]."""
    command, displacement = np.asarray(batch.command), np.asarray(batch.displacement)
    modelled = np.asarray(benchmark)
    time_s = np.broadcast_to(batch.step_s * np.arange(command.shape[1]), command.shape)
    samples = Sample(*(jnp.asarray(each.T) for each in (time_s, command, modelled, displacement)))
    _, features = _measured_features(samples, batch.step_s)
    return np.swapaxes(np.asarray(features), 0, 1), displacement - modelled


def _spread(rows: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each feature, 1 where it is constant."""
    spread = rows.std(axis=0)
    return np.where(spread > 1e-12 * np.maximum(1.0, np.abs(rows).max(axis=0)), spread, 1.0)


def _sequences(compensator: Compensator, features: np.ndarray, errors: np.ndarray, batch: Batch) -> Sequences:
    """Cut tests into stretches of 2 L samples, L apart, the first beginning L before the test."""
    window, counts = compensator.window, np.asarray(batch.counted)
    count = features.shape[1]
    stretches = -(-count // window)
    behind = ((0, 0), (window, stretches * window - count))
    scaled = np.pad(np.asarray(compensator.scale(jnp.asarray(features))), (*behind, (0, 0)))
    valid = np.pad(counts, behind)
    steps = np.diff(errors, axis=1, prepend=errors[:, :1]) / float(compensator.error_step)
    targets = np.pad(steps, behind).astype(np.float32)

    starts = window * np.arange(stretches)
    positions = starts[:, None] + np.arange(2 * window)
    # The prediction for sample k is made after reading sample k − 1, so targets lie one behind features.
    reading, predicted = positions - 1, positions[:, window:]
    counted = valid[:, predicted] & valid[:, predicted - 1]
    keep = counted.any(axis=2)

    def stacked(array: np.ndarray) -> Array:
        return jnp.asarray(array[keep])

    return Sequences(
        features=stacked(scaled[:, np.maximum(reading, 0)]),
        valid=stacked(valid[:, np.maximum(reading, 0)] & (reading >= 0)),
        target=stacked(targets[:, predicted]),
        counted=stacked(counted),
    )


def _squared_error(network: Lstm, sequences: Sequences) -> tuple[Array, Array]:
    window = sequences.target.shape[1]
    outputs = network.outputs(jnp.swapaxes(sequences.features, 0, 1), sequences.valid.T)
    misses = (outputs[window:].T - sequences.target) * sequences.counted
    return jnp.sum(misses**2), jnp.sum(sequences.counted)
