"""Calibration of the gains of a hitch that was identified from strokes, so that whole logs agree."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from hitchid._support.metrics import better_on_held_out_tests
from hitchid.data.record import Record
from hitchid.model import Channel, Hitch

MAX_LOG_FACTOR = 0.1  # largest logarithm of a factor: a gain from strokes is known better than that
SAMPLE_STRIDE = 10  # samples; errors in free run change slowly against the clock
STEP = 1e-3  # of the logarithm, for finite differences


def calibrate_gains(hitch: Hitch, records: Sequence[Record]) -> dict[str, float]:
    """Return the factors on the gains with which free runs of whole records fit the measurement best.

    Each stroke begins at a measured displacement, so a small error of the gain has little effect in it; over
    a whole record it adds up. Least squares over the logarithms of the factors, each test weighing the
    same.

    Args:
        hitch: benchmarks identified from strokes.
        records: the mixed records they come from.

    Returns:
        Direction to factor, within ±10 %; a channel without a gain is left out.
    """
    directions = _with_gains(hitch)

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        return np.concatenate(_residuals(hitch, directions, logarithms, records))

    best = least_squares(
        residuals,
        np.zeros(len(directions)),
        bounds=(-MAX_LOG_FACTOR, MAX_LOG_FACTOR),
        diff_step=STEP,
        x_scale=STEP,
    )
    return dict(zip(directions, np.exp(best.x).tolist(), strict=True))


def calibration_improves(hitch: Hitch, records: Sequence[Record]) -> bool:
    """Return whether factors fitted to the other records improve records held out in turn.

    To first order in the logarithms of the factors; see `better_on_held_out_tests`. False for one record.

    Args:
        hitch, records: as for `calibrate_gains`.
    """
    directions = _with_gains(hitch)
    zeros = np.zeros(len(directions))
    nominal = _residuals(hitch, directions, zeros, records)
    perturbed = [
        _residuals(hitch, directions, STEP * unit_vector, records) for unit_vector in np.eye(len(directions))
    ]
    jacobians = [
        np.stack(
            [(perturbed_residuals[number] - residuals) / STEP for perturbed_residuals in perturbed], axis=1
        )
        for number, residuals in enumerate(nominal)
    ]
    held_out = []
    for number, residuals in enumerate(nominal):
        others = [index for index in range(len(records)) if index != number]
        if not others:
            return False
        log_factors = np.linalg.lstsq(
            np.concatenate([jacobians[index] for index in others]),
            -np.concatenate([nominal[index] for index in others]),
            rcond=None,
        )[0]
        held_out.append(residuals + jacobians[number] @ np.clip(log_factors, -MAX_LOG_FACTOR, MAX_LOG_FACTOR))
    errors, nominal_errors = (np.array([np.linalg.norm(row) for row in rows]) for rows in (held_out, nominal))
    return better_on_held_out_tests(errors, nominal_errors)


def _with_gains(hitch: Hitch) -> list[str]:
    """Return the directions whose channels have a gain."""
    channels = hitch.channels.items()
    return [direction for direction, channel in channels if channel.benchmark.structure.gain]


def _residuals(
    hitch: Hitch, directions: Sequence[str], logarithms: np.ndarray, records: Sequence[Record]
) -> list[np.ndarray]:
    """Return the free-run errors of each record; their norm is the root mean square."""
    scaled_hitch = scaled(hitch, dict(zip(directions, np.exp(logarithms), strict=True)))
    all_errors = [
        (scaled_hitch.simulate(record).displacement - record.displacement)[::SAMPLE_STRIDE]
        for record in records
    ]
    return [errors / np.sqrt(errors.size) for errors in all_errors]


def scaled(hitch: Hitch, factors: Mapping[str, float]) -> Hitch:
    """Return a hitch with factors on the gains of its channels."""
    scaled_channels = {name: with_gain(hitch.channels[name], factor) for name, factor in factors.items()}
    return replace(hitch, channels={**hitch.channels, **scaled_channels})


def with_gain(channel: Channel, factor: float) -> Channel:
    """Return a channel with its gain multiplied by a factor.

    Raises:
        InputError: its structure has no gain.
    """
    return replace(channel, benchmark=channel.benchmark.with_gain(factor))
