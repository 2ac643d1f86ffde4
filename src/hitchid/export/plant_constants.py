"""Numbers of a direction's physical model, as plain Python numbers."""

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from hitchid.errors import InputError
from hitchid.export.rows import Rows, rows
from hitchid.model import Channel
from hitchid.structures import DiscretePhysicalModel, StaticNonlinearity
from hitchid.structures.cascaded_tanks import CascadedTanks
from hitchid.structures.discretisation import STROKE_NODES, StrokeModel
from hitchid.structures.first_order_lag import FirstOrderLag
from hitchid.structures.inertia_with_friction import InertiaWithFriction
from hitchid.structures.integrator import Integrator
from hitchid.structures.integrator_first_order import IntegratorFirstOrder
from hitchid.structures.integrator_second_order import IntegratorSecondOrder
from hitchid.structures.nonlinear import NonlinearStructure

# Structures whose equations the templates hold: state space from parameters, or the vector field.
STATE_SPACES = {
    Integrator: "integrator",
    IntegratorFirstOrder: "integrator_first_order",
    FirstOrderLag: "first_order_lag",
    IntegratorSecondOrder: "integrator_second_order",
}
VECTOR_FIELDS = {InertiaWithFriction: "inertia_with_friction", CascadedTanks: "cascaded_tanks"}


@dataclass(frozen=True)
class Plant:
    """Physical model of a direction at the sampling time.

    Attributes:
        form: name of the equations in the templates.
        states: n.
        values: the structure's parameters.
        substeps: of a sample, in the integration of a nonlinear structure; 0 of a linear one.
        nodes: places on the stroke at which it is discretised.
        transition, gamma0, gamma1, friction: Φ, Γ₀, Γ₁ and the gains of dry friction, at each node; empty
            of a nonlinear structure.
        speed_row, speed_gain: speed = row · state + gain · flow.
        friction_at_rest: φ₀; None without dry friction.
        friction_travel, natural_frequency, frequency_slope: of a load with dry friction.
        delay_samples: m, whole samples of dead time.
        dead_time_parts_s: parts of a sample with the flow of the sample before and with the present one, s.
    """

    form: str
    states: int
    values: Rows
    substeps: int
    nodes: int
    transition: Rows
    gamma0: Rows
    gamma1: Rows
    friction: Rows
    speed_row: Rows
    speed_gain: float
    friction_at_rest: float | None
    friction_travel: float
    natural_frequency: float
    frequency_slope: float
    delay_samples: int
    dead_time_parts_s: tuple[float, float]


def plant_of(channel: Channel, discrete: DiscretePhysicalModel) -> Plant:
    """Return the numbers of a channel's benchmark, which is given discretised, too.

    Raises:
        InputError: its equations are not known here.
    """
    benchmark, step_s = channel.benchmark, discrete.step_s
    structure = benchmark.structure
    if isinstance(structure, NonlinearStructure):
        form = _form(structure, VECTOR_FIELDS)
        if form is None:
            raise _unknown(structure.name)
        return Plant(
            form=form,
            states=int(np.asarray(structure.init_state(benchmark.values, jnp.zeros(1))).shape[0]),
            values=rows(benchmark.values),
            substeps=structure.substeps,
            nodes=1,
            transition=(),
            gamma0=(),
            gamma1=(),
            friction=(),
            speed_row=(),
            speed_gain=0.0,
            friction_at_rest=None,
            friction_travel=0.0,
            natural_frequency=0.0,
            frequency_slope=0.0,
            delay_samples=0,
            dead_time_parts_s=(0.0, step_s),
        )
    linear = structure.require_linear()
    form = _form(linear, STATE_SPACES)
    if form is None and (benchmark.scheduling is not None or linear.has_dry_friction):
        raise _unknown(linear.name)
    values = dict(
        zip((each.name for each in linear.parameters), np.asarray(benchmark.values).tolist(), strict=True)
    )
    a, b = (np.asarray(part) for part in linear.state_space(benchmark.values))
    along = benchmark.discretised_along_stroke(step_s)
    nodes = STROKE_NODES if benchmark.varies_along_stroke else 1
    models = along.models if isinstance(along, StrokeModel) else along
    friction = models.friction
    samples = float(benchmark.dead_time_s) / step_s
    fraction = min(max(samples - math.floor(samples + 1e-9), 0.0), 1.0)
    return Plant(
        form=form or "linear",
        states=b.size,
        values=rows(benchmark.values),
        substeps=0,
        nodes=nodes,
        transition=_per_node(models.transition, nodes, (b.size, b.size)),
        gamma0=_per_node(models.gamma0, nodes, (b.size,)),
        gamma1=_per_node(models.gamma1, nodes, (b.size,)),
        friction=() if friction is None else _per_node(friction.gains, nodes, (b.size,)),
        speed_row=rows(a[0]),
        speed_gain=float(b[0]),
        friction_at_rest=values.get("friction_at_rest") if linear.has_dry_friction else None,
        friction_travel=values.get("friction_travel", 0.0),
        natural_frequency=values.get("natural_frequency", 0.0),
        frequency_slope=values.get("frequency_slope", 0.0) if benchmark.varies_along_stroke else 0.0,
        delay_samples=discrete.delay_samples,
        dead_time_parts_s=(fraction * step_s, (1 - fraction) * step_s),
    )


def _form(structure: object, forms: dict[type, str]) -> str | None:
    """Return the name of a structure's equations; None of a structure of another package."""
    if type(structure).__module__.partition(".")[0] != "hitchid":
        return None
    return next((name for kind, name in reversed(forms.items()) if isinstance(structure, kind)), None)


def _unknown(name: str) -> InputError:
    known = ", ".join([*STATE_SPACES.values(), *VECTOR_FIELDS.values()]).replace("_", "-")
    return InputError(
        f"structure {name}: expected one whose equations the export knows ({known}), or a linear one without "
        "covariates and dry friction"
    )


def _per_node(array: object, nodes: int, shape: tuple[int, ...]) -> Rows:
    return rows(np.asarray(array).reshape(nodes, *shape))


def curves_of(nonlinearity: StaticNonlinearity, step_s: float) -> dict[str, float]:
    """Return the numbers of the nonlinearities of valve and stroke at the sampling time."""
    names = (
        "opening",
        "exponent",
        "saturation",
        "hysteresis",
        "spool_lag",
        "position_slope",
        "position_curve",
    )
    curves = {name: float(value) for name, value in zip(names, nonlinearity.named(*names), strict=True)}
    decay = float(np.exp(-step_s / curves["spool_lag"]))
    scales = nonlinearity.scales
    return curves | {
        "command_scale": float(scales.command),
        "centre": float(scales.centre),
        "span": float(scales.span),
        "decay": decay,
        "mean_share": curves["spool_lag"] / step_s * (1 - decay),
    }


def scheduling_of(channel: Channel) -> dict[str, Any] | None:
    """Return what covariates change, and by how much; None where they change nothing."""
    scheduling, nonlinearity = channel.benchmark.scheduling, channel.benchmark.nonlinearity
    if scheduling is None or nonlinearity is None:
        return None
    scales = nonlinearity.scales.covariates
    names = [parameter.name for parameter in channel.benchmark.structure.parameters]
    return {
        "centre": rows(scales.centre),
        "spread": rows(scales.spread),
        # Index of the structure's parameter; −1: the opening of the valve.
        "targets": tuple(names.index(name) if name in names else -1 for name in scheduling.quantities),
        "effects": rows(scheduling.effects),
    }
