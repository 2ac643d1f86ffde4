"""Hand-made models with every structure and every option, for tests of the export."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Channel, Hitch
from hitchid.model.limits import TravelLimits
from hitchid.model.load_filter import LoadFilter
from hitchid.structures import PhysicalModel, Scales, StaticNonlinearity, structure_named

with jax.enable_x64(True):
    import handmade

FRICTION = (18.0, 0.6, 0.8, -0.5)  # rad/s, 1, mm, 1
STROKE = (*FRICTION, 0.4)
EFFECTS = {
    "gain": 0.2,
    "gain_squared": -0.05,
    "opening": 0.04,
    "natural_frequency": -0.2,
    "damping_ratio": 0.3,
}
LIMITS = TravelLimits(40.0, 170.0, True, False)


def plant(
    name: str, values: tuple[float, ...], *, scheduled=False, curves=False, dead_time_s=0.0
) -> PhysicalModel:
    """Return a physical model of any structure."""
    structure = structure_named(name)
    nonlinearity, scheduling = None, None
    if curves or scheduled:
        nonlinearity, scheduling = handmade.scheduled(structure, **EFFECTS)
    if not scheduled:
        scheduling = None
        if nonlinearity is not None:
            scales = nonlinearity.scales
            nonlinearity = StaticNonlinearity(
                nonlinearity.values, Scales(scales.command, scales.centre, scales.span)
            )
    return PhysicalModel(structure, jnp.array(values), jnp.asarray(dead_time_s), nonlinearity, scheduling)


def with_plants(model: Hitch, *plants: PhysicalModel) -> Hitch:
    """Return a model with other physical models in its channels."""
    channels = {
        direction: replace(channel, benchmark=benchmark)
        for (direction, channel), benchmark in zip(model.channels.items(), plants, strict=True)
    }
    return Hitch(channels, model.step_s, {**model.units, "pressure": "bar"}, drift=model.drift)


def changed(model: Hitch, *, drift: float = 0.0, **fields) -> Hitch:
    """Return a model with other fields of its channels, given for all or by direction."""

    def of(direction: str) -> dict:
        return {
            name: value[direction] if isinstance(value, dict) else value for name, value in fields.items()
        }

    channels = {direction: replace(channel, **of(direction)) for direction, channel in model.channels.items()}
    return replace(model, channels=channels, drift=drift)


def correcting_up_to(horizons: dict[str, int], model: Hitch, **fields) -> Hitch:
    """Return `changed` whose compensators for predictions end at horizons by direction."""
    compensators = {
        direction: replace(channel.compensator, max_horizon=horizons[direction])
        for direction, channel in model.channels.items()
    }
    return changed(model, compensator=compensators, **fields)


def nonlinear(name: str) -> Hitch:
    """Return a model of a nonlinear structure."""
    values = {
        "inertia-with-friction": (40.0, 3.0, 0.1, 0.02, 0.3, 0.02, 1e-3, 0.01),
        "cascaded-tanks": (0.012, 0.02, 0.015, 0.02, 0.001, 0.8, 0.4, 1.0),
    }[name]
    step_s = {"inertia-with-friction": 0.01, "cascaded-tanks": 4.0}[name]
    channel = Channel(
        LIFTING,
        1,
        0.0,
        None,
        PhysicalModel(structure_named(name), jnp.array(values), jnp.asarray(0.0)),
        handmade.envelope(command=(0.0, 1.0), displacement=(0.0, 5.0)),
        load_filter=LoadFilter(*map(jnp.asarray, (0.005, 0.02, 5.0, 0.1, 0.2, 0.02))),
    )
    return Hitch({LIFTING: channel}, step_s, {"displacement": "m", "lifting_command": "V"})


def made_up() -> dict[str, Hitch]:
    """Return models by what they contain."""
    both = (LIFTING, LOWERING)
    gains = (30.0, 20.0)
    plain = handmade.hitch("integrator-second-order", filtered=True)
    friction = with_plants(
        plain,
        *(plant("integrator-second-order-friction", (gain, *FRICTION), dead_time_s=0.02) for gain in gains),
    )
    stroke = with_plants(
        plain,
        *(
            plant("integrator-second-order-stroke", (gain, *STROKE), curves=True, dead_time_s=0.013)
            for gain in gains
        ),
    )
    compensated = {"compensated": True, "free_run": True, "filtered": True}
    return {
        "integrator": handmade.hitch(),
        "dead time of several samples": handmade.hitch("integrator", filtered=True, dead_time_s=0.05),
        "first order, fractional dead time": handmade.hitch(
            "integrator-first-order", filtered=True, dead_time_s=0.034
        ),
        "first-order lag": handmade.hitch("first-order-lag", filtered=True, dead_time_s=0.004),
        "second order, one channel": handmade.hitch(
            "integrator-second-order", modes=(LOWERING,), filtered=True
        ),
        "dry friction": friction,
        "dynamics along the stroke": stroke,
        "covariates": handmade.hitch_of(
            *(handmade.channel(mode, "integrator-second-order", shape=True, filtered=True) for mode in both)
        ),
        "covariates along the stroke": with_plants(
            plain,
            *(
                plant("integrator-second-order-stroke", (gain, *STROKE), scheduled=True, dead_time_s=0.034)
                for gain in gains
            ),
        ),
        "covariates of one channel": handmade.hitch_of(
            handmade.channel(LIFTING, "integrator-first-order", filtered=True),
            handmade.channel(LOWERING, "integrator-first-order", shape=True, dead_time_s=0.02),
        ),
        "end stops": changed(plain, end_stop={LIFTING: 110.0, LOWERING: 90.0}),
        "limits and drift": changed(plain, drift=-0.4, limits=LIMITS),
        "inertia with friction": nonlinear("inertia-with-friction"),
        "cascaded tanks": nonlinear("cascaded-tanks"),
        "compensators": handmade.hitch("integrator-second-order", dead_time_s=0.034, **compensated),
        "compensator of one channel": handmade.hitch_of(
            handmade.channel(LIFTING, "integrator", compensated=True),
            handmade.channel(LOWERING, "integrator", free_run=True, filtered=True),
        ),
        "everything": handmade.with_bands(
            correcting_up_to(
                {LIFTING: 2, LOWERING: 40},
                handmade.hitch_of(
                    *(
                        handmade.channel(
                            mode,
                            "integrator-second-order",
                            shape=True,
                            dead_time_s=0.034,
                            covered=handmade.envelope(load=(90.0, 150.0)),
                            **compensated,
                        )
                        for mode in both
                    )
                ),
                drift=0.05,
                limits=LIMITS,
                end_stop={LIFTING: 165.0, LOWERING: 45.0},
            ),
            *both,
        ),
    }


with jax.enable_x64(True):
    MODELS = made_up()
