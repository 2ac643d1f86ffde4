"""Fits the baselines on the same tests and with the same validation as the compensator."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid.baselines.autoregression import Arx
from hitchid.baselines.black_box import BlackBox, accumulated, speeds
from hitchid.identification.training import AdamConfig, EpochCallback, every_nth, train
from hitchid.networks.lstm import SINGLE, Lstm
from hitchid.structures import Batch

ARX_ORDERS = (1, 2, 3, 5, 8, 12, 20)
SECTION_SAMPLES, MAX_SECTIONS = 2048, 40


def fit_arx(training: Batch, validation: Batch) -> Arx:
    """Return the ARX model whose order predicts the validation tests best one step ahead."""
    tests, validation_tests = _tests(training), _tests(validation)

    def squared_error(model: Arx) -> float:
        return sum(
            float(np.sum((model.one_step(command, travel) - travel)[loss_mask] ** 2))
            for command, travel, loss_mask in validation_tests
        )

    return min((Arx.fit(tests, order) for order in ARX_ORDERS), key=squared_error)


def fit_black_box(
    training: Batch,
    validation: Batch,
    *,
    hidden: int,
    adam: AdamConfig,
    key: PRNGKeyArray,
    progress: EpochCallback | None = None,
    checkpoints: Checkpoints = DISABLED,
) -> BlackBox:
    """Return a black-box LSTM trained on free runs from the start of each test.

    Tests longer than 2048 samples are cut, each section starting from its own measured displacement; of more
    than 40 sections every m-th is taken.

    Args:
        training, validation: the tests the compensator has too.
        hidden: cells of the LSTM.
        adam: Adam and early stopping.
        key: initial weights and shuffling.
        progress, checkpoints: see `descend`.
    """
    init_key, key = jax.random.split(key)
    training_sections, validation_sections = (
        every_nth(_sections(batch), MAX_SECTIONS) for batch in (training, validation)
    )
    commands, initial, travel, loss_mask = training_sections
    changes = np.diff(travel, axis=1)[loss_mask[:, 1:]]
    untrained = BlackBox(
        network=Lstm.init(init_key, 2, hidden),
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
        adam,
        key,
        progress,
        checkpoints,
    )
    return BlackBox(
        network, untrained.command_scale, untrained.initial_centre, untrained.initial_scale, untrained.change
    )


def _squared_error(network: Lstm, sections: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Return the sum of squares of the misses, each weighted, and how many count."""
    inputs, travel, weight = sections
    residuals = (accumulated(speeds(network, inputs)) - travel) * weight
    return jnp.sum(residuals**2), jnp.sum(weight > 0)


def _tests(batch: Batch) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return command, travel and which samples count of each test, without padding."""
    return [
        (np.asarray(command)[valid], np.asarray(travel)[valid], np.asarray(loss_mask)[valid])
        for command, travel, loss_mask, valid in zip(
            batch.command, batch.travel, batch.loss_mask, np.asarray(batch.valid), strict=True
        )
    ]


def _sections(batch: Batch) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return commands, initial displacement, travel and which samples count, cut to 2048 samples at most."""
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
