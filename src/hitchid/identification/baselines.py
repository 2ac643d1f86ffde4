"""Fits the baselines on the same tests and with the same validation as the compensator."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid.baselines.autoregression import Arx
from hitchid.baselines.black_box import BlackBox, accumulated, speeds
from hitchid.identification.descent import Descent, Progress, descend, evenly
from hitchid.networks.lstm import SINGLE, Lstm
from hitchid.structures import Batch

ARX_ORDERS = (1, 2, 3, 5, 8, 12, 20)
SECTION, MOST_SECTIONS = 2048, 40


def fit_arx(training: Batch, validation: Batch) -> Arx:
    """Return the ARX model whose order predicts the validation tests best one step ahead."""
    tests, held = _tests(training), _tests(validation)

    def missed(model: Arx) -> float:
        return sum(
            float(np.sum((model.one_step(command, travel) - travel)[counted] ** 2))
            for command, travel, counted in held
        )

    return min((Arx.fit(tests, order) for order in ARX_ORDERS), key=missed)


def fit_black_box(
    training: Batch,
    validation: Batch,
    *,
    hidden: int,
    descent: Descent,
    key: PRNGKeyArray,
    progress: Progress | None = None,
    kept: Checkpoints = NOWHERE,
) -> BlackBox:
    """Return a black-box LSTM trained on free runs from the start of each test.

    Tests longer than 2048 samples are cut, each section starting from its own measured displacement; of more
    than 40 sections every m-th is taken.

    Args:
        training, validation: the tests the compensator has too.
        hidden: cells of the LSTM.
        descent: Adam and early stopping.
        key: initial weights and shuffling.
        progress, kept: see `descend`.
    """
    init_key, key = jax.random.split(key)
    train, held = (evenly(_sections(each), MOST_SECTIONS) for each in (training, validation))
    commands, initial, travel, counted = train
    changes = np.diff(travel, axis=1)[counted[:, 1:]]
    fresh = BlackBox(
        network=Lstm.fresh(init_key, 2, hidden),
        command_scale=jnp.asarray(np.abs(commands).max()),
        initial_centre=jnp.asarray(initial.mean()),
        initial_scale=jnp.asarray(initial.std() or 1.0),
        change=jnp.asarray(float(np.abs(changes).mean()) or 1.0),
    )
    size = float(travel[counted].std()) / float(fresh.change)

    def data(part: tuple) -> tuple:
        commands, initial, travel, counted = part
        return (
            fresh.inputs(jnp.asarray(commands), jnp.asarray(initial)),
            jnp.asarray(travel / float(fresh.change), SINGLE),
            jnp.asarray(counted / size, SINGLE),
        )

    network, _ = descend(fresh.network, _squared_error, data(train), data(held), descent, key, progress, kept)
    return BlackBox(network, fresh.command_scale, fresh.initial_centre, fresh.initial_scale, fresh.change)


def _squared_error(network: Lstm, part: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Return the sum of squares of the misses, each weighted, and how many count."""
    inputs, travel, weight = part
    misses = (accumulated(speeds(network, inputs)) - travel) * weight
    return jnp.sum(misses**2), jnp.sum(weight > 0)


def _tests(batch: Batch) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return command, travel and which samples count of each test, without padding."""
    return [
        (np.asarray(command)[valid], np.asarray(travel)[valid], np.asarray(counted)[valid])
        for command, travel, counted, valid in zip(
            batch.command, batch.travel, batch.counted, np.asarray(batch.valid), strict=True
        )
    ]


def _sections(batch: Batch) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return commands, initial displacement, travel and which samples count, cut to 2048 samples at most."""
    command, displacement = np.asarray(batch.command), np.asarray(batch.displacement)
    counted, initial = np.asarray(batch.counted), np.asarray(batch.initial)
    width = min(command.shape[1], SECTION)
    parts = []
    for first in range(0, command.shape[1], width):
        span = slice(first, first + width)
        short = width - command[:, span].shape[1]

        def cut(array: np.ndarray, *, span: slice = span, short: int = short) -> np.ndarray:
            return np.pad(array[:, span], ((0, 0), (0, short)))

        start = initial if first == 0 else displacement[:, first]
        travel = batch.direction * (cut(displacement) - start[:, None])
        parts.append((cut(command), start, travel, cut(counted)))
    commands, starts, travel, counts = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    used = counts.any(axis=1)
    return commands[used], starts[used], travel[used], counts[used]
