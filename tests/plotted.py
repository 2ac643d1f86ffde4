"""One object of each kind that can be plotted, put together by hand."""

from dataclasses import replace

import numpy as np

import handmade
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING, Record
from hitchid.model import (
    Characteristics,
    Estimate,
    Estimates,
    MeasuredSpeed,
    Quantity,
    SpeedPoint,
    Uncertainty,
)
from hitchid.structures import DEAD_TIME
from hitchid.validation import Accuracy, ChannelResult, Horizons, ModelComparison, Predictions, Validation
from hitchid.validation.residuals import residual_tests

STEP_S = handmade.STEP_S
RELATIVE_ERROR = 0.05


def record(name="up", *, direction=LIFTING, samples=300, seed=0):
    """Return a test of one direction; its displacement follows the command of one second."""
    command = np.zeros(samples)
    command[50:150] = 0.6
    sign = 1 if direction == LIFTING else -1
    noise = 0.01 * np.random.default_rng(seed).standard_normal(samples)
    signals = {"displacement": 100 + 0.1 * sign * np.cumsum(command) + noise}
    for own in (LIFTING, LOWERING):
        signals[f"{own}_command"] = command if own == direction else 0 * command
    return Record(name, STEP_S, signals, handmade.UNITS)


def campaign(tests=3):
    """Return some tests of each direction."""
    return Campaign.of(
        [
            record(f"{direction}-{i}", direction=direction, seed=i)
            for direction in (LIFTING, LOWERING)
            for i in range(tests)
        ]
    )


def predictions(models=("benchmark", "free_run", "one_step"), sizes=(300, 250, 280), *, band=True):
    """Return tests of a sine with random walks around them as predictions."""
    rng = np.random.default_rng(0)
    time_s = tuple(STEP_S * np.arange(size) for size in sizes)
    actual = tuple(100 + 40 * np.sin(times) for times in time_s)
    runs = {name: tuple(y + 0.1 * rng.standard_normal(y.size).cumsum() for y in actual) for name in models}
    middle = runs["free_run"] if band and "free_run" in runs else None
    ends = None if middle is None else tuple(tuple(y + side for y in middle) for side in (-2.0, 2.0))
    return Predictions(tuple(f"up-{i}" for i in range(len(sizes))), time_s, actual, runs, ends)


def residuals():
    """Return tests of errors that depend on the command."""
    rng = np.random.default_rng(0)
    command = [np.repeat(rng.uniform(0, 0.5, 12), 25)]
    errors = [0.1 * rng.standard_normal(signal.size) + 0.3 * signal for signal in command]
    places = [100 + np.cumsum(signal) for signal in command]
    return residual_tests(errors, command, places, [signal / STEP_S for signal in command], step_s=STEP_S)


def validation(tests=None, *, diverged=False):
    """Return the validation of a lifting channel."""
    accuracy = Accuracy({}, Horizons((), {}), {}, predictions() if tests is None else tests)
    by_run = {"free_run": None if diverged else residuals(), "one_step": residuals()}
    result = ChannelResult(accuracy, by_run)
    return Validation("mm", {LIFTING: result}, None, None, (), handmade.hitch(), campaign())


def comparison():
    """Return two validations of the same tests."""
    return ModelComparison(("A", "B"), (validation(), validation()), 0, STEP_S)


def characteristics(load=None):
    """Return operating characteristics at three levels; the upper end of the last speed is open."""
    points = tuple(
        SpeedPoint.of(level, pressure, speed, (0.9 * speed, None if level == 0.8 else 1.1 * speed), 30.0)
        for level in (0.4, 0.6, 0.8)
        for pressure in ((None,) if load is None else (90.0, 120.0))
        for speed in (50.0 * (level - 0.3),)
    )
    zone = Quantity("dead zone", "A", 0.3, (0.29, 0.31), True)
    measured = (MeasuredSpeed(0.4, None, 4.5), MeasuredSpeed(0.8, None, 20.5))
    return Characteristics("A", "mm/s", load, zone, None, 0.6, None, None, points, measured)


def estimates(benchmark):
    """Return independent estimates of every parameter of a model, to 5 %."""
    names = [parameter.name for parameter in benchmark.structure.parameters]
    values = dict(zip(names, map(float, benchmark.values), strict=True))
    if float(benchmark.dead_time_s):
        values[DEAD_TIME.name] = float(benchmark.dead_time_s)
    return Estimates(
        tuple(estimate(name, value) for name, value in values.items()),
        (),
        tuple(map(tuple, np.eye(len(values)).tolist())),
        5,
        5,
    )


def estimate(name, value, *, error=None, **options):
    """Return the estimate of a parameter, to 5 % unless said otherwise."""
    bounds = {"lower": value / 100, "upper": value * 100, "linear": False} | options
    return Estimate(
        name=name,
        symbol=name,
        unit="1",
        value=value,
        error=RELATIVE_ERROR * value if error is None else error,
        interval=(0.9 * value, 1.1 * value),
        method="Gauss-Newton",
        bootstrap=None,
        determined=True,
        verdict="determined",
        sensitivity=0.1,
        **bounds,
    )


def hitch(structure="integrator-second-order", **options):
    """Return a model of both directions with estimates and speed maps."""
    model = handmade.hitch(structure, dead_time_s=0.03, **options)
    uncertainty = {
        direction: Uncertainty(
            estimates(channel.benchmark),
            characteristics=characteristics(None if direction == LIFTING else "pressure"),
        )
        for direction, channel in model.channels.items()
    }
    return replace(model, uncertainty=uncertainty)
