"""Hand-made controllers of hand-made hitches."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

import handmade
from hitchid.control.axis import Axis
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.loops import Margins
from hitchid.control.tuning import DirectionMargins, Tuning
from hitchid.logs.record import DIRECTIONS

DEAD_TIME_S = 0.064
LAG_S = 0.08
PRESSURE = {"pressure": 125.0}


def made_up_model(*, shape: bool):
    """Return a hitch of which the speed lags, with a dead time of a fraction of a sample."""
    model = handmade.hitch("integrator-first-order", dead_time_s=DEAD_TIME_S, shape=shape)
    if not shape:
        return model
    # As fast just above its opening as a hitch of the same gain without curves.
    channels = {
        direction: replace(
            channel,
            benchmark=channel.benchmark.with_gain(float(channel.benchmark.nonlinearity.largest_share)),
        )
        for direction, channel in model.channels.items()
    }
    return replace(model, channels=channels)


def _gains(*values: float) -> Gains:
    return Gains(*map(jnp.asarray, values))


def made_up_controller(model) -> HitchController:
    """Return a controller of a hand-made hitch."""
    axes = []
    for direction in DIRECTIONS:
        channel = model.channels[direction]
        axis = Axis.of(
            channel.benchmark,
            sign=channel.sign,
            dead_zone=channel.dead_zone,
            step_s=0.01,
            largest_command=channel.dead_zone + 0.5,
        )
        axes.append(axis.at_load(PRESSURE) if channel.benchmark.covariates else axis)
    fastest = np.array([float(axis.fastest(jnp.asarray(100.0))) for axis in axes])
    return HitchController(
        axes=(axes[0], axes[1]),
        gains=(_gains(3.0, 1.1, 0.0, 0.0), _gains(2.5, 0.8, 0.1, 0.01)),
        deceleration=jnp.asarray(fastest / LAG_S),
        speed_share=jnp.asarray(0.98),
        lags_s=jnp.asarray([axis.lags[0] for axis in axes]),
        crossing_speed=jnp.asarray([0.45, 0.4]),
        hold=HoldWindow(jnp.asarray(0.075), jnp.asarray(0.3)),
        rate=jnp.asarray(40.0),
    )


def made_up_tuning(controller: HitchController, load: dict[str, float], *, gain_db: float = 7.5) -> Tuning:
    """Return a tuning that ends in a controller."""
    worst = Margins(*map(np.asarray, (gain_db, 51.0, 0.21, 1.6, 0.9)))
    margins = {direction: DirectionMargins(worst, worst, 0.07) for direction in DIRECTIONS}
    return Tuning(controller, "PI", {"PI": 31.0}, margins, load, handmade.UNITS, 200)
