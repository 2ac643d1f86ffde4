"""Black-box LSTM from command to speed."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.baselines.fitted import FittedBaseline
from hitchid.estimation.training import every_nth, train
from hitchid.networks.lstm import SINGLE, Lstm
from hitchid.structures import Batch

SECTION_SAMPLES, MAX_SECTIONS = 2048, 40  # samples, sections; chosen: they bound the training time


class BlackBox(FittedBaseline):
    """LSTM from command to speed, followed by an integrator; no other physics.

    w(k) = σ Σ_{i<k} f(u(0) … u(i), x(0)), simulated from the start of a test.

    Attributes:
        network: LSTM with command and initial displacement as inputs.
        command_scale: largest command of the training tests, shape [].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
        change: σ, mean absolute change of travel in one sample, shape [].
    """

    network: Lstm
    command_scale: Float[Array, ""]
    initial_centre: Float[Array, ""]
    initial_scale: Float[Array, ""]
    change: Float[Array, ""]

    def inputs(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n 2"]:
        """Return the scaled inputs, shape [T, N, 2]."""
        scaled_initial = (initial - self.initial_centre) / self.initial_scale
        broadcast_initial = jnp.broadcast_to(scaled_initial[:, None], command.shape)
        return jnp.stack([command / self.command_scale, broadcast_initial], axis=-1).astype(SINGLE)

    def travel(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n"]:
        """Return travel simulated from commands and initial displacement, shape [T, N]."""
        return self.change * accumulated(speeds(self.network, self.inputs(command, initial)))

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        travel = eqx.filter_jit(BlackBox.travel)(self, batch.command, batch.initial)
        return np.asarray(batch.initial)[:, None] + batch.sign * np.asarray(travel)

    def predict(self, batch: Batch, horizons: Sequence[int]) -> None:
        """Return None: the model only simulates; it takes no measured displacement after the start."""


class BlackBoxBaseline(Baseline):
    """Black-box LSTM trained on free runs."""

    name, title = "lstm", "black-box LSTM"

    def fit(self, training: Batch, validation: Batch, context: FitContext) -> BlackBox:
        """Return a black-box LSTM trained on free runs from the start of each test.

        Tests longer than 2048 samples are cut into sections, each starting from its own measured
        displacement; of more than 40 sections every m-th is used.

        Args:
            training, validation: the tests of the compensator.
            context: settings of the fit.
        """
        init_key, key = jax.random.split(context.key)
        training_sections, validation_sections = (
            every_nth(_sections(batch), MAX_SECTIONS) for batch in (training, validation)
        )
        commands, initial, travel, loss_mask = training_sections
        changes = np.diff(travel, axis=1)[loss_mask[:, 1:]]
        untrained = BlackBox(
            network=Lstm.init(init_key, 2, context.hidden),
            command_scale=jnp.asarray(np.abs(commands).max()),
            initial_centre=jnp.asarray(initial.mean()),
            initial_scale=jnp.asarray(initial.std() or 1.0),
            change=jnp.asarray(float(np.abs(changes).mean()) or 1.0),
        )
        travel_scale = float(travel[loss_mask].std()) / float(untrained.change)

        def data(sections: tuple) -> tuple:
            commands, initial, travel, loss_mask = sections
            return (
                untrained.inputs(jnp.asarray(commands), jnp.asarray(initial)),
                jnp.asarray(travel / float(untrained.change), SINGLE),
                jnp.asarray(loss_mask / travel_scale, SINGLE),
            )

        network, _ = train(
            untrained.network,
            _squared_error,
            data(training_sections),
            data(validation_sections),
            context.adam,
            key,
            context.progress,
            context.checkpoints,
        )
        return BlackBox(
            network,
            untrained.command_scale,
            untrained.initial_centre,
            untrained.initial_scale,
            untrained.change,
        )

    def skeleton(self, shapes: Sizes) -> BlackBox:
        """Return an untrained model with an LSTM of the stored size."""
        hidden = shapes["network/cell/weight_hh"][1]
        return BlackBox(Lstm.init(jax.random.key(0), 2, hidden), *(jnp.ones(()) for _ in range(4)))


def speeds(network: Lstm, inputs: Float[Array, "t n i"]) -> Float[Array, "t n"]:
    """Return the network's output at every sample of every test, shape [T, N]."""
    rows = jnp.swapaxes(inputs, 0, 1)
    return network.unroll(rows, jnp.ones(rows.shape[:2], bool)).T


def accumulated(changes: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return the sum of the changes before each sample, shape [T, N]."""
    return jnp.cumsum(changes, axis=1) - changes


def _squared_error(network: Lstm, sections: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Return the weighted sum of squared errors, and the number of samples with a weight."""
    inputs, travel, weight = sections
    residuals = (accumulated(speeds(network, inputs)) - travel) * weight
    return jnp.sum(residuals**2), jnp.sum(weight > 0)


def _sections(batch: Batch) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return commands, initial displacements, travel and loss masks of sections of at most 2048 samples."""
    command, displacement = np.asarray(batch.command), np.asarray(batch.displacement)
    loss_mask, initial = np.asarray(batch.loss_mask), np.asarray(batch.initial)
    width = min(command.shape[1], SECTION_SAMPLES)
    sections = []
    for first in range(0, command.shape[1], width):
        span = slice(first, first + width)
        padding = width - command[:, span].shape[1]

        def cut(array: np.ndarray, *, span: slice = span, padding: int = padding) -> np.ndarray:
            return np.pad(array[:, span], ((0, 0), (0, padding)))

        start = initial if first == 0 else displacement[:, first]
        travel = batch.sign * (cut(displacement) - start[:, None])
        sections.append((cut(command), start, travel, cut(loss_mask)))
    commands, starts, travel, counts = (np.concatenate(arrays) for arrays in zip(*sections, strict=True))
    used = counts.any(axis=1)
    return commands[used], starts[used], travel[used], counts[used]
