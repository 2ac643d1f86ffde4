"""Mechanistic model from data sheets and mechanics, without fitted parameters."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hitchid._support.precision import double_precision
from hitchid.data.record import LIFTING
from hitchid.experiments.drawn_commands import HIGH, LOW
from hitchid.experiments.virtual_campaign import DYNAMIC_S, STROKE_FRACTION
from hitchid.rig import (
    OperatingPoint,
    Rig,
    SmallSignal,
    load_rig,
    lowering_small_signal,
    rig_limits,
    small_signal,
)
from hitchid.structures import PhysicalModel, structure_named

STRUCTURE = "integrator-second-order"
STEPS = 6  # of Newton's method; chosen, enough for convergence


class Mechanistic(NamedTuple):
    """Transfer function of one direction, in mm and A, and the dead zone before it, in A."""

    physical_model: PhysicalModel
    dead_zone: float


@double_precision
def mechanistic(rig: str | Path | Rig, direction: str) -> Mechanistic:
    """Return the transfer function of one direction computed from a rig's parameters alone.

    K/(s (s²/ωh² + 2 ξh s/ωh + 1)), in mm, s and A; ωh and ξh by `small_signal`, for lowering, where gravity
    drives the oil through the throttle, by `lowering_small_signal`. The operating point is the mean one of
    the tests of `virtual_campaign`: speed v₀ at the mean level, where the highest level covers 0.6 of the
    stroke in 10 s, and the middle of that travel, 5 s · v₀ from the start. The command is effective above the
    dead zone, so the gain is the secant of speed over current from the dead zone to that point, not the slope
    there; v(u₀) = v₀ is solved by Newton's method with that slope:

        K = v₀/u₀,  u₀ = current − dead zone,  dead zone = overlap + half the hysteresis (a rising current)

    The lags of solenoid, spool and pressure compensator are neglected. Sun et al. 2025 cite
    such a model in their discussion (their ref. 9).

    Args:
        rig: parameter set of the virtual test bench, or the rig itself.
        direction: lifting or lowering.

    Raises:
        SettingsError: the rig's parameters cannot be used.
    """
    bench = rig if isinstance(rig, Rig) else load_rig(rig)
    limits, lifting = rig_limits(bench), direction == LIFTING
    spool = bench.lifting_valve.spool if lifting else bench.lowering_valve.spool
    mean_level = float(np.mean(LOW + HIGH))
    travel = mean_level * STROKE_FRACTION * limits.stroke_m
    displacement = 0.5 * travel if lifting else limits.stroke_m - 0.5 * travel

    def linearise(effective: float) -> SmallSignal:
        point = OperatingPoint(displacement, float(spool.dead_zone) + effective)
        return small_signal(bench, point) if lifting else lowering_small_signal(bench, point)

    wide_open = float(spool.saturation - spool.dead_zone)
    effective = 0.5 * wide_open
    for _ in range(STEPS):  # speed is convex in the current: from the second, iterates are above
        linear_model = linearise(effective)
        effective = min(
            effective + (1e3 * travel / DYNAMIC_S - linear_model.speed) / linear_model.gain, wide_open
        )
    linear_model = linearise(effective)
    values = jnp.asarray(
        [linear_model.speed / effective, linear_model.natural_frequency, linear_model.damping_ratio]
    )
    return Mechanistic(
        PhysicalModel(structure_named(STRUCTURE), values, jnp.asarray(0.0)),
        limits.lifting_dead_zone_a if lifting else limits.lowering_dead_zone_a,
    )
