"""Numbers of what predicts the error of a physical model, and of its bands, as plain Python numbers."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchid.model import Bands, LoadFilter
from hitchid.networks import RANGE_MARGIN, Compensator, OperatingRange, SignalRange, SpeedCompensator

# Arrays as nested tuples, which templates write as arrays of C.

Rows = tuple[Any, ...]  # nested tuples of numbers


def rows(array: object) -> Rows:
    """Return an array as nested tuples."""

    def frozen(part: object) -> object:
        return tuple(map(frozen, part)) if isinstance(part, list) else part

    result = frozen(np.asarray(array).tolist())
    return result if isinstance(result, tuple) else (result,)


LONGEST = 1e300  # stands for an infinite length, which C cannot write as a number
COVERAGE = 0.9  # of the exported band: the one that reports state


@dataclass(frozen=True)
class Range:
    """Range of a signal in the identification tests, and the width over which trust falls beyond it."""

    lowest: float
    highest: float
    margin: float
    half_width: float

    @classmethod
    def of(cls, signal: SignalRange, index: int = 0) -> "Range | None":
        """Return a range, of several signals that at an index; None where it is not bounded."""
        ends = [float(np.asarray(end).ravel()[index]) for end in (signal.lowest, signal.highest)]
        if not all(map(math.isfinite, ends)):
            return None
        width = ends[1] - ends[0]
        # A signal that stood still in the tests has no width to take a share of.
        return cls(ends[0], ends[1], RANGE_MARGIN * width if width > 0 else 1.0, 0.5 * width)

    @classmethod
    def all_of(cls, covered: OperatingRange) -> "dict[str, Range | list[Range | None] | None]":
        """Return the ranges of command, displacement and covariates by name."""
        signals = {"command": cls.of(covered.command), "displacement": cls.of(covered.displacement)}
        count = np.asarray(covered.load.lowest).size
        return {**signals, "load": [cls.of(covered.load, number) for number in range(count)]}

    @property
    def middle(self) -> float:
        """Middle of the range."""
        return 0.5 * (self.lowest + self.highest)


def filter_of(load_filter: LoadFilter, step_s: float) -> dict[str, float]:
    """Return the variances of a load filter, and how much of its transient is kept, at the sampling time."""
    noise, transient_s = float(load_filter.noise), float(load_filter.transient_time)
    return {
        "noise_variance": noise**2,
        "load_variance": float(load_filter.load_scatter) ** 2,
        "load_length": min(float(load_filter.load_length), LONGEST),
        "transient_kept": math.exp(-step_s / transient_s),
        "transient_variance": -math.expm1(-2 * step_s / transient_s)
        * float(load_filter.transient_scatter) ** 2,
        "drift_variance": float(load_filter.drift) ** 2 * step_s,
    }


def compensator_of(compensator: Compensator) -> dict[str, Any]:
    """Return the weights of the network for predictions, and the scales of its inputs."""
    network = compensator.network
    hidden = network.cell.hidden_size
    return {
        "hidden": hidden,
        "window": compensator.window,
        "max_horizon": compensator.max_horizon,
        "error_step": float(compensator.error_step),
        "centre": rows(compensator.centre),
        "spread": rows(compensator.spread),
        "input_weights": rows(network.cell.weight_ih),
        "state_weights": rows(network.cell.weight_hh),
        "bias": rows(network.cell.bias),
        "output_weights": rows(network.head.weight[0]),
        "output_bias": float(np.asarray(network.head.bias)[0]),
    }


def speed_compensator_of(compensator: SpeedCompensator) -> dict[str, Any]:
    """Return the weights of the networks for free run, their scales, and the ranges they cover."""
    networks = compensator.networks
    return {
        "members": compensator.members,
        "units": networks.biases.shape[1],
        "inputs": networks.input_weights.shape[2],
        "input_weights": rows(networks.input_weights),
        "biases": rows(networks.biases),
        "output_weights": rows(networks.output_weights),
        "command_scale": float(compensator.command_scale),
        "speed_scale": float(compensator.speed_scale),
        "acceleration_scale": float(compensator.acceleration_scale),
        "sign": compensator.sign,
        "ranges": Range.all_of(compensator.operating_range),
    }


def bands_of(bands: Bands) -> dict[str, Any]:
    """Return the table of the band around predictions at `COVERAGE`; see `Bands.half_width`."""
    from scipy.special import ndtri  # not at the top: half a second

    spread = bands.predictions
    return {
        "noise": spread.noise,
        "floor": float(ndtri(0.5 + COVERAGE / 2)) * spread.noise,
        "exponent": spread.exponent,
        "log_horizons": tuple(math.log(horizon) for horizon in spread.horizons),
        "last_horizon": float(spread.horizons[-1]),
        "movements": spread.movements,
        "growths": spread.growths,
        "multipliers": tuple(float(np.interp(COVERAGE, bands.levels, row)) for row in spread.multipliers),
    }
