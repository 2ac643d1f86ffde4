"""A validation put together by hand, with every part that tables, figures and pages show."""

from dataclasses import replace
from functools import cache

import numpy as np

import handmade
import reported
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, Record
from hitchid.validation import Accuracy, ChannelResult, CycleResult, RunFigures, Validation
from hitchid.validation.results import ModelFigures, figures_by_test

SIZES = (300, 250, 280)


def predictions(sizes=SIZES):
    """Return tests with a command and predictions."""
    tests = reported.predictions(sizes)
    command = tuple(0.5 + 0.4 * np.sign(np.sin(9 * time_s)) for time_s in tests.time_s)
    return replace(tests, commands={"lifting_command": command})


def accuracy():
    """Return errors of the benchmark, the grey box and a baseline that diverged."""
    tests = predictions()
    free, one_step = (RunFigures.of(tests.actual, tests.models[run]) for run in ("free_run", "one_step"))
    none = RunFigures(None, None, None, None, None, None)
    models = {
        "persistence": ModelFigures(one_step=one_step),
        "narx": ModelFigures(one_step, none),
        "benchmark": ModelFigures(free_run=RunFigures.of(tests.actual, tests.models["benchmark"])),
        "greybox": ModelFigures(one_step, free),
    }
    return Accuracy(models, reported.horizons(), figures_by_test(tests), tests, reported.bands())


@cache
def validation():
    """Return a validation of lifting and of cycles."""
    errors = accuracy()
    channel = ChannelResult(
        errors,
        {"one_step": reported.residuals(), "free_run": reported.residuals(seed=1)},
        parameters=reported.known_estimates(),
        paper_parameters=reported.known_estimates(*reported.ESTIMATES[:2]),
        characteristics=reported.characteristics(),
        load_scatter=reported.load_scatter(),
        searches=tuple(reported.searches()),
    )
    cycles = CycleResult(Accuracy(errors.models, errors.horizons, errors.per_test, errors.predictions), None)
    model = handmade.hitch("integrator-second-order", modes=(LIFTING,), dead_time_s=0.03)
    model = replace(model, units={**model.units, "head_pressure": "bar"})
    signals = {"displacement": errors.predictions.actual[0], "lifting_command": np.full(SIZES[0], 0.5)}
    record = Record("up-01", reported.STEP_S, signals, {"displacement": "mm", "lifting_command": "A"})
    return Validation("mm", {LIFTING: channel}, cycles, None, ("a notice",), model, Campaign.of([record]))
