"""Figures of a position controller: the worst of 95 % of its closed loops in each scenario."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid._support.short_repr import short_repr
from hitchid.control.closed_loop import ClosedLoops
from hitchid.control.scenarios import Kind, Scenario
from hitchid.rig.simulation import SAMPLE_S

SHARE = 0.95  # of the loops, whose worst figure is stated
FINAL_S = 1.0  # s at the end of a run over which the final error is averaged
ON_A = 1e-9  # A, above which a valve is on


@short_repr
class Figures(NamedTuple):
    """Figures of one controller in one scenario; the worst of 95 % of the loops.

    Attributes:
        iae: ∫ abs(target − displacement) dt, the mean of the loops.
        rmse: of the tracking.
        overshoot: beyond the end of a step; None without one.
        settling_s: until the displacement stays within the tolerance of a step; None without one.
        final_error: distance of the mean measured displacement of the last second to the target.
        valve_actions_per_10_s: how often a valve opens.
        both_valves_samples: samples of all loops with current in both valves.
        samples_until_closed: samples with current after the sensor was lost, the longest; None otherwise.
        diverged: loops with a displacement that is not finite.
    """

    iae: float
    rmse: float
    overshoot: float | None
    settling_s: float | None
    final_error: float
    valve_actions_per_10_s: float
    both_valves_samples: int
    samples_until_closed: int | None
    diverged: int

    @classmethod
    def of(cls, scenario: Scenario, loops: ClosedLoops) -> "Figures":
        """Return the figures of closed loops in a scenario."""
        begin = scenario.begin
        errors = (loops.displacement - scenario.target)[:, begin:]
        final = loops.measured[:, -round(FINAL_S / SAMPLE_S) :] - scenario.target[-1]
        on = loops.commands > ON_A
        opened = np.sum(np.diff(on.astype(int), axis=1) > 0, axis=(1, 2))
        duration_s = SAMPLE_S * scenario.target.size
        return cls(
            iae=float(np.mean(_iae(errors))),
            rmse=_worst(np.sqrt(np.mean(errors**2, axis=1))),
            overshoot=_overshoot(scenario, errors),
            settling_s=_settling_s(scenario, errors),
            final_error=_worst(np.abs(np.nanmean(final, axis=1))),
            valve_actions_per_10_s=_worst(10 * opened / duration_s),
            both_valves_samples=int(np.sum(np.all(on, axis=-1))),
            samples_until_closed=_samples_until_closed(scenario, on),
            diverged=int(np.sum(~np.isfinite(loops.displacement).all(axis=1))),
        )


def iae_ratios(
    figures: Mapping[str, Figures], baseline: Mapping[str, Figures], kinds: Mapping[str, Kind]
) -> dict[str, float]:
    """Return the ratio of the IAE to a baseline's: geometric means over the steps, ramps and sines.

    The kinds count alike in `all`, whatever their number and length: the IAE of a step of 100 mm, which at
    the largest current no controller can change, is fifty times that of a ramp.

    Args:
        figures, baseline: scenario to figures.
        kinds: scenario to kind.
    """
    ratios = {}
    for kind in (Kind.STEP, Kind.RAMP, Kind.SINE):
        logs = [np.log(figures[name].iae / baseline[name].iae) for name, own in kinds.items() if own is kind]
        ratios[kind.value] = float(np.exp(np.mean(logs)))
    return {"all": float(np.exp(np.mean(np.log(list(ratios.values()))))), **ratios}


def _worst(values: Float[np.ndarray, " t"]) -> float:
    return float(np.quantile(values, SHARE))


def _iae(errors: Float[np.ndarray, "t n"]) -> Float[np.ndarray, " t"]:
    return SAMPLE_S * np.abs(errors).sum(axis=1)


def _overshoot(scenario: Scenario, errors: Float[np.ndarray, "t n"]) -> float | None:
    if not scenario.amplitude:
        return None
    beyond = np.sign(scenario.amplitude) * errors
    return _worst(np.maximum(beyond.max(axis=1), 0.0))


def _settling_s(scenario: Scenario, errors: Float[np.ndarray, "t n"]) -> float | None:
    """Return the time after which no displacement is outside the tolerance; infinite at the end of a run."""
    if not scenario.amplitude:
        return None
    outside = ~(np.abs(errors) <= scenario.tolerance)
    last = errors.shape[1] - np.argmax(outside[:, ::-1], axis=1)
    settled = np.where(outside.any(axis=1), np.where(outside[:, -1], np.inf, last), 0)
    ordered = np.sort(SAMPLE_S * settled)
    return float(ordered[int(np.ceil(SHARE * ordered.size)) - 1])


def _samples_until_closed(scenario: Scenario, on: Bool[np.ndarray, "t n 2"]) -> int | None:
    lost = np.asarray(scenario.surroundings.sensor_lost)
    if not lost.any():
        return None
    still_on = np.asarray(np.any(on[:, lost], axis=2))
    samples = still_on.shape[1] - np.argmax(still_on[:, ::-1], axis=1)
    return int(np.max(np.where(np.any(still_on, axis=1), samples, 0)))
