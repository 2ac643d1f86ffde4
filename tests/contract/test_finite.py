"""Every form has finite errors and finite derivatives everywhere between its bounds and at them."""

from dataclasses import replace

import numpy as np
import pytest

from hitchid.estimation import Objective
from hitchid.logs.record import LIFTING
from hitchid.structures import BUILT_IN, Batch, CovariateEffects, ModelSpec, structure_named
from hitchid.structures.structure import LinearStructure
from truth import levels

SAMPLES = 120
WIDEST = ModelSpec(
    structure_named("integrator-second-order"),
    dead_time=True,
    valve_curve=True,
    spool_dynamics=True,
    stroke_gain_quadratic=True,
    covariates=(CovariateEffects("p", dynamics=True, quadratic=True),),
)
PLAIN = [ModelSpec(own, dead_time=True) for own in BUILT_IN if isinstance(own, LinearStructure)]
# A nonlinear structure is integrated step by step, on clocks of the plants it is for.
CLOCKS = {"inertia-with-friction": (1e-3,), "cascaded-tanks": (4.0,)}
CASES = [
    *((form, clock) for form in PLAIN for clock in (1e-3, 4.0)),
    *((WIDEST, clock) for clock in (1e-3, 0.05, 4.0)),
    (replace(WIDEST, stroke_gain_quadratic=False, stroke_gain_linear=True), 0.01),
    *((ModelSpec(structure_named(name)), clock) for name, clocks in CLOCKS.items() for clock in clocks),
]


def batch_for(make_record, clock, form):
    """Return tests of both signs of command, saturated, without motion, and one that never leaves rest."""
    rng = np.random.default_rng(5)
    commands = [
        levels(rng, SAMPLES, low=-0.6, high=1.0),
        np.ones(SAMPLES),
        levels(rng, SAMPLES),
        np.zeros(SAMPLES),
    ]
    travels = [np.cumsum(clock * command) for command in commands]
    travels[2] = np.zeros(SAMPLES)
    records = [
        replace(
            make_record(5.0 + travel, command),
            step_s=clock,
            signals={
                "displacement": 5.0 + travel,
                "lifting_command": command,
                "p": np.full(SAMPLES, 90.0 + number),
            },
            units={"displacement": "mm", "lifting_command": "A", "p": "bar"},
        )
        for number, (command, travel) in enumerate(zip(commands, travels, strict=True))
    ]
    return Batch.of(records, LIFTING, dead_zone=0.1, sign=1, covariates=form.covariate_names)


def named(form, clock):
    """Return a case with its name; those of the valve curve, and of the fastest clock, are not long."""
    name = f"{form.structure.name}{' with all curves' if form.valve_curve else ''}, {clock:g} s"
    return pytest.param(
        form, clock, id=name, marks=() if form.valve_curve or clock == 1e-3 else pytest.mark.long
    )


@pytest.mark.parametrize(("form", "clock"), [named(*case) for case in CASES])
def test_errors_and_derivatives_are_finite_between_bounds_and_at_them(make_record, form, clock):
    misfit = Objective.of(batch_for(make_record, clock, form), form)
    equations = misfit.problem().normal_equations
    count, rng = len(form.parameters), np.random.default_rng(7)
    inside = rng.random((40, count))
    corners = rng.integers(0, 2, (40, count)).astype(float)
    edges = np.where(rng.random((40, count)) < 0.3, corners, inside)
    for position in np.concatenate([inside, corners, edges]):
        assert equations(position).finite, misfit.values(position)
