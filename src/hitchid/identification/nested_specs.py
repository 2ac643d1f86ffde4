"""Nested candidates based on the second-order integrator, and the starts of their least squares."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from hitchid.structures import CovariateEffects, ModelSpec, Parameter, structure_named
from hitchid.structures.static_nonlinearity import SPOOL_DYNAMICS, VALVE_CURVE

# Positions between the bounds, 0 to 1, at which an option has no effect, or as little as the bounds allow.
NEUTRAL_POSITIONS = {
    "opening": 0.4,
    "exponent": 0.5,
    "saturation": 1.0,
    "hysteresis": 0.0,
    "spool_lag": 0.0,
    "dead_time": 0.0,
}
MIDDLE = 0.5  # position of the other parameters
# Opening beside a dead zone from ramps, share of the largest effective command. A ramp shows the opening but
# for its spread and the plant's delay; the bounds leave room for a rounded onset.
RAMP_OPENING_BOUNDS = (-0.1, 0.1)
# Positions between the bounds: a soft, little damped and a stiff, more damped plant; valve curves that are
# even, rise slowly or saturate early; narrow to wide hysteresis.
SECOND_ORDER_STARTS = (
    {"natural_frequency": 0.4, "damping_ratio": 0.45},
    {"natural_frequency": 0.7, "damping_ratio": 0.7},
)
DEAD_TIME_START = 0.6
CURVE_STARTS = (
    {"opening": 0.4, "exponent": 0.5, "saturation": 0.4},
    {"opening": 0.25, "exponent": 0.75, "saturation": 0.3},
    {"opening": 0.5, "exponent": 0.6, "saturation": 0.3},
)
# Friction that compresses the oil by a thousandth of the range of displacement; the load came to rest against
# the direction of travel, or along it.
FRICTION_STARTS = (
    {"friction_travel": 0.6, "friction_at_rest": 0.15},
    {"friction_travel": 0.6, "friction_at_rest": 0.85},
)
# Half and one and a half times the frequency at an end of the range, in either sense.
FREQUENCY_STARTS = ({"frequency_slope": 0.3}, {"frequency_slope": 0.7})
# What follows the best form of a structure: name of the next structure, what it adds, and its starts.
NEXT_STRUCTURES = {
    "integrator-second-order": ("integrator-second-order-friction", "dry friction", FRICTION_STARTS),
    "integrator-second-order-friction": (
        "integrator-second-order-stroke",
        "a natural frequency that varies along the stroke",
        FREQUENCY_STARTS,
    ),
}
HYSTERESIS_STARTS = (0.05, 0.1, 0.2)
SPOOL_LAG_START = 0.5


def largest_spec(baseline: ModelSpec, *, opening_known: bool) -> ModelSpec:
    """Return the largest candidate without covariates."""
    return replace(
        baseline,
        structure=structure_named("integrator-second-order"),
        dead_time=True,
        bounds={"opening": RAMP_OPENING_BOUNDS} if opening_known else {},
        valve_curve=True,
        spool_dynamics=True,
        stroke_gain_quadratic=True,
        covariates=(),
    )


def nested_specs(largest: ModelSpec) -> list[tuple[str, ModelSpec]]:
    """Return names and specifications of the candidates, from a dead time alone to all options."""
    delayed = replace(
        largest,
        bounds={},
        valve_curve=False,
        spool_dynamics=False,
        stroke_gain_quadratic=False,
    )
    with_curve = replace(delayed, bounds=largest.bounds, valve_curve=True)
    with_spool = replace(with_curve, spool_dynamics=True)
    with_slope = replace(with_spool, stroke_gain_linear=True)
    named_specs = [
        ("second order, dead time", delayed),
        ("with valve curve", with_curve),
        ("with spool lag and hysteresis", with_spool),
        ("with a gain linear along the stroke", with_slope),
        ("with a gain quadratic along the stroke", largest),
    ]
    return named_specs[:1] + [
        current for previous, current in pairwise(named_specs) if current[1] != previous[1]
    ]


def covariate_specs(spec: ModelSpec, covariate: str) -> list[tuple[str, ModelSpec]]:
    """Return names and specifications of a form with more effects of a covariate than it has, few to many."""
    steps = (
        (f"with {covariate} on speed and opening", CovariateEffects(covariate)),
        (f"with {covariate} on dynamics, too", CovariateEffects(covariate, dynamics=True)),
        (f"with {covariate} and its square", CovariateEffects(covariate, dynamics=True, quadratic=True)),
    )
    others = tuple(effects for effects in spec.covariates if effects.covariate != covariate)
    first = next((number for number, (_, effects) in enumerate(steps, 1) if effects in spec.covariates), 0)
    return [(name, replace(spec, covariates=(*others, effects))) for name, effects in steps[first:]]


def starts(spec: ModelSpec, previous: Sequence[Parameter]) -> Sequence[Mapping[str, float]]:
    """Return starting positions, by name, of the parameters that a candidate adds to the one before it.

    Args:
        spec: the form.
        previous: parameters of the form before it, empty for none.
    """
    names = {parameter.name for parameter in previous}
    if not names:
        return [{**first, "dead_time": DEAD_TIME_START} for first in SECOND_ORDER_STARTS]
    if spec.valve_curve and VALVE_CURVE[0].name not in names:
        return CURVE_STARTS
    if spec.spool_dynamics and SPOOL_DYNAMICS[0].name not in names:
        return [
            {"hysteresis": width, "spool_lag": SPOOL_LAG_START, **curve}
            for width in HYSTERESIS_STARTS
            for curve in ({}, CURVE_STARTS[0])
        ]
    return ({},)
