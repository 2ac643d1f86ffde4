"""Gains of a hitch identified from strokes of mixed logs, levelled so that whole logs agree."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from scipy.optimize import least_squares

from hitchid.benchmark.structure import LinearStructure
from hitchid.model import Channel, Hitch
from hitchid.record import Record

MOST = 0.1
EVERY = 10
DIFFERENCE = 1e-3


def levelling(hitch: Hitch, records: Sequence[Record]) -> dict[str, float]:
    """Return the factors on the gains with which whole records in free run agree best with what was measured.

    Strokes each begin at a measured displacement, so a gain that is a little off shows in each but little;
    over a whole record it adds up. Least squares over the logarithms of the factors, each test weighing the
    same.

    Args:
        hitch: benchmarks identified from strokes.
        records: the mixed records they come from.

    Returns:
        Mode to factor, within ±10 %; a channel without a gain is left out.
    """
    modes = [
        mode
        for mode, channel in hitch.channels.items()
        if isinstance(channel.benchmark.structure, LinearStructure)
    ]

    def misses(logarithms: np.ndarray) -> np.ndarray:
        factors = dict(zip(modes, np.exp(logarithms), strict=True))
        moved = scaled(hitch, factors)
        runs = [(moved.simulate(record) - record.displacement)[::EVERY] for record in records]
        return np.concatenate([run / np.sqrt(run.size) for run in runs])

    best = least_squares(
        misses, np.zeros(len(modes)), bounds=(-MOST, MOST), diff_step=DIFFERENCE, x_scale=DIFFERENCE
    )
    return dict(zip(modes, np.exp(best.x).tolist(), strict=True))


def scaled(hitch: Hitch, factors: Mapping[str, float]) -> Hitch:
    """Return a hitch with factors on the gains of its channels."""
    channels = {mode: with_gain(channel, factors.get(mode, 1.0)) for mode, channel in hitch.channels.items()}
    return replace(hitch, channels=channels)


def with_gain(channel: Channel, factor: float) -> Channel:
    """Return a channel with a factor on its gain, the first parameter of a linear structure."""
    return eqx.tree_at(
        lambda each: each.benchmark.values, channel, channel.benchmark.values.at[0].multiply(factor)
    )
