"""Signals of tests in blocks of several steps, the clock of the black box."""

from typing import NamedTuple

import numpy as np

from hitchid.structures import Batch

MAX_BLOCKS, STEPS = 64, 8  # blocks of the longest test, steps in a block; chosen: they bound the time


class BlockSignals(NamedTuple):
    """Signals of T tests in K blocks of M steps.

    Attributes:
        commands: mean of the command as logged and of the effective command, shape [K, T, M, 2].
        travel: travel at the end of each step, shape [K, T, M].
        mask: which of those errors are taken over, shape [K, T, M].
    """

    commands: np.ndarray
    travel: np.ndarray
    mask: np.ndarray


def step_samples(batch: Batch) -> int:
    """Return the samples of one step, so that the longest test has at most 64 blocks of eight steps."""
    longest = int(np.asarray(batch.valid).sum(axis=1).max())
    return -(-longest // (MAX_BLOCKS * STEPS))


def block_signals(batch: Batch, samples: int, mask: np.ndarray) -> BlockSignals:
    """Return the signals of tests in blocks of eight steps of so many samples each.

    Args:
        batch: tests.
        samples: samples in a step.
        mask: samples that errors are taken over, shape [T, N].
    """
    blocks = -(-int(np.asarray(batch.valid).sum(axis=1).max()) // (samples * STEPS))
    width = blocks * STEPS * samples

    def in_blocks(rows: np.ndarray) -> np.ndarray:
        return rows.reshape(rows.shape[0], blocks, STEPS, *rows.shape[2:]).swapaxes(0, 1)

    def fitted_to_width(rows: np.ndarray) -> np.ndarray:
        return np.pad(rows, ((0, 0), (0, max(0, width + 1 - rows.shape[1]))))[:, : width + 1]

    def means(rows: np.ndarray) -> np.ndarray:
        return fitted_to_width(rows)[:, :width].reshape(len(rows), -1, samples).mean(axis=2)

    commands = (np.asarray(batch.raw_command), np.asarray(batch.command))
    ends = slice(samples, None, samples)
    return BlockSignals(
        in_blocks(np.stack([means(command) for command in commands], axis=-1)),
        in_blocks(fitted_to_width(np.asarray(batch.travel))[:, ends]),
        in_blocks(fitted_to_width(np.asarray(mask))[:, ends]),
    )


def travel_at_samples(travel: np.ndarray, samples: int, count: int) -> np.ndarray:
    """Return travel at every sample, linear between the ends of steps, shape [T, N].

    Args:
        travel: at the end of each step, shape [K, T, M]; zero before the first.
        samples: samples in a step.
        count: N, samples of the result; it stays at the last value beyond the steps.
    """
    rows = np.moveaxis(travel, 1, 0).reshape(travel.shape[1], -1)
    ends = samples * np.arange(rows.shape[1] + 1)
    return np.stack([np.interp(np.arange(count), ends, [0.0, *row]) for row in rows])
