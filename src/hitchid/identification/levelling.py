"""Gains of a hitch identified from strokes of mixed logs, levelled so that whole logs agree."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from scipy.optimize import least_squares

from hitchid._support.metrics import proven_better
from hitchid.data.record import Record
from hitchid.model import Channel, Hitch
from hitchid.structures.structure import LinearStructure

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
    modes = _with_gains(hitch)

    def misses(logarithms: np.ndarray) -> np.ndarray:
        return np.concatenate(_misses(hitch, modes, logarithms, records))

    best = least_squares(
        misses, np.zeros(len(modes)), bounds=(-MOST, MOST), diff_step=DIFFERENCE, x_scale=DIFFERENCE
    )
    return dict(zip(modes, np.exp(best.x).tolist(), strict=True))


def calibration_improves(hitch: Hitch, records: Sequence[Record]) -> bool:
    """Tell whether records held out in turn are followed better with factors that the others give.

    To first order in the logarithms of the factors; see `proven_better`. One record alone proves nothing.

    Args:
        hitch, records: as for `levelling`.
    """
    modes = _with_gains(hitch)
    nothing = np.zeros(len(modes))
    here = _misses(hitch, modes, nothing, records)
    beside = [_misses(hitch, modes, DIFFERENCE * one, records) for one in np.eye(len(modes))]
    slopes = [
        np.stack([(other[number] - own) / DIFFERENCE for other in beside], axis=1)
        for number, own in enumerate(here)
    ]
    held_out = []
    for number, own in enumerate(here):
        others = [each for each in range(len(records)) if each != number]
        if not others:
            return False
        found = np.linalg.lstsq(
            np.concatenate([slopes[each] for each in others]),
            -np.concatenate([here[each] for each in others]),
            rcond=None,
        )[0]
        held_out.append(own + slopes[number] @ np.clip(found, -MOST, MOST))
    return proven_better(*(np.array([np.linalg.norm(row) for row in rows]) for rows in (held_out, here)))


def _with_gains(hitch: Hitch) -> list[str]:
    """Return the modes whose channels have a gain."""
    channels = hitch.channels.items()
    return [mode for mode, each in channels if isinstance(each.benchmark.structure, LinearStructure)]


def _misses(
    hitch: Hitch, modes: Sequence[str], logarithms: np.ndarray, records: Sequence[Record]
) -> list[np.ndarray]:
    """Return what each record misses in free run, its norm the root mean square."""
    moved = scaled(hitch, dict(zip(modes, np.exp(logarithms), strict=True)))
    runs = [(moved.simulate(record) - record.displacement)[::EVERY] for record in records]
    return [run / np.sqrt(run.size) for run in runs]


def scaled(hitch: Hitch, factors: Mapping[str, float]) -> Hitch:
    """Return a hitch with factors on the gains of its channels."""
    channels = {mode: with_gain(channel, factors.get(mode, 1.0)) for mode, channel in hitch.channels.items()}
    return replace(hitch, channels=channels)


def with_gain(channel: Channel, factor: float) -> Channel:
    """Return a channel with a factor on its gain, the first parameter of a linear structure."""
    return eqx.tree_at(
        lambda each: each.benchmark.values, channel, channel.benchmark.values.at[0].multiply(factor)
    )
