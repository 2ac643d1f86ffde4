"""What a campaign of the zoo is made of, drawn from a seed."""

from dataclasses import dataclass, replace

import numpy as np

from .commands import SHAPES
from .logs import Clock, Columns, Sensor
from .plants import (
    Dynamics,
    Plant,
    Valve,
    first_order_lag,
    integrator,
    integrator_first_order,
    integrator_second_order,
)

Rng = np.random.Generator
TRAVEL = {
    "mm": (50.0, 900.0),
    "m": (0.05, 0.9),
    "cm": (5.0, 90.0),
    "deg": (20.0, 120.0),
    "rad": (0.3, 2.0),
    "V": (1.0, 10.0),
    "1": (0.5, 1.0),
}
FULL_SCALE = {
    "A": (0.5, 2.0),
    "mA": (300.0, 2000.0),
    "V": (5.0, 10.0),
    "percent": (50.0, 100.0),
    "1": (1.0, 1.0),
    "rpm": (500.0, 3000.0),
    "bar": (20.0, 200.0),
}
STRUCTURES = ("integrator", "integrator-first-order", "integrator-second-order", "first-order-lag")
WEIGHTS = (0.2, 0.35, 0.3, 0.15)
LAYOUTS = ("two columns", "signed", "lifting", "lowering")
TYPICAL_SAMPLES, LARGE_SAMPLES = 24_000, 100_000
DEFECTS = ("without motion", "at the stop", "saturated")
# A hydraulic axis is logged for so long at least; what goes up and down, for some strokes.
SHORTEST_S, SHORTEST_BOTH_S = 0.3, 8.0


@dataclass(frozen=True)
class Schedule:
    """Which tests there are.

    Attributes:
        tests, samples: how many, and of how many samples each.
        shapes: of the commands, taken in turn.
        mixed: whether a test goes both ways.
        closed_loop: whether a controller gives the commands.
        scatter: standard deviation of the logarithm of the load's factor on speed.
        defect: what is wrong with one test; empty where nothing is.
        unusable: why no model can be had; empty where one can.
    """

    tests: int
    samples: int
    shapes: tuple[str, ...]
    mixed: bool
    closed_loop: bool
    scatter: float
    defect: str
    unusable: str


@dataclass(frozen=True)
class Design:
    """A whole campaign.

    Attributes:
        seed: it is drawn from.
        structure: name of the dynamics, in hitchid's words.
        values: their parameters in hitchid's parametrisation, without the gain, which is set by the travel.
        full: largest command, in its unit.
        travel: of the piston, in the displacement's unit.
    """

    seed: int
    structure: str
    values: dict[str, float]
    valves: tuple[Valve, Valve]
    full: float
    travel: float
    stops: bool
    schedule: Schedule
    clock: Clock
    sensor: Sensor
    columns: Columns

    @property
    def dynamics(self) -> Dynamics:
        """Return the dynamics."""
        dead_time_s = self.values.get("dead_time", 0.0)
        if self.structure == "integrator-second-order":
            return integrator_second_order(
                self.values["natural_frequency"], self.values["damping_ratio"], dead_time_s
            )
        lag = self.values.get("time_constant")
        if lag is None:
            return integrator(dead_time_s)
        build = first_order_lag if self.structure == "first-order-lag" else integrator_first_order
        return build(lag, dead_time_s)

    def plant(self, gains: tuple[float, float]) -> Plant:
        """Return the plant with speeds per command."""
        stops = (0.0, self.travel) if self.stops else (-np.inf, np.inf)
        return Plant(self.dynamics, self.valves, gains, stops)


def draw_design(seed: int) -> Design:
    """Draw a campaign; nearly every second has nothing beyond the forms that hitchid chooses from."""
    rng = np.random.default_rng(seed)
    plain = bool(rng.random() < 0.45)
    structure = str(rng.choice(STRUCTURES[:3] if plain else STRUCTURES, p=None if plain else WEIGHTS))
    clock = _clock(rng)
    schedule, layout = _schedule(rng, clock)
    # The first gap begins after a quarter of a test at the earliest: a shorter test may have no part of the
    # 20 samples that a log must have.
    if plain or schedule.samples < 80:
        clock = replace(clock, gaps=0)
    if plain:
        schedule = replace(
            schedule, mixed=False, scatter=0.0, unusable="", defect=schedule.defect and DEFECTS[0]
        )
    columns = _columns(rng, layout)
    full = float(f"{rng.uniform(*FULL_SCALE[columns.command_unit]):.3g}")
    if columns.zero:
        columns = replace(columns, zero=float(f"{columns.zero * full:.5g}"))
    shared, other = _valve(rng, full), _valve(rng, full)
    if plain:
        shared, other = replace(shared, saturation=np.inf), replace(other, saturation=np.inf)
    stops = not plain and (bool(rng.random() < 0.25) or schedule.defect == "at the stop")
    sensor = _sensor(rng)
    return Design(
        seed,
        structure,
        _values(rng, structure, clock, schedule.samples),
        (shared, other if rng.random() < 0.5 else shared),
        full,
        float(f"{rng.uniform(*TRAVEL[columns.displacement_unit]):.3g}"),
        stops,
        schedule,
        clock,
        replace(sensor, drift=0.0, spikes=0.0) if plain else sensor,
        columns,
    )


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(max(low, high)))))


def _clock(rng: Rng) -> Clock:
    step_s = float(f"{_log_uniform(rng, 1e-3, 4.0):.2g}")
    kind = rng.choice(["even", "jittered", "gaps", "both"], p=[0.5, 0.25, 0.15, 0.1])
    jitter = float(rng.uniform(0.02, 0.45)) if kind in ("jittered", "both") else 0.0
    return Clock(step_s, jitter, int(rng.integers(1, 4)) if kind in ("gaps", "both") else 0)


def _schedule(rng: Rng, clock: Clock) -> tuple[Schedule, str]:
    large = rng.random() < 0.06
    samples = round(_log_uniform(rng, 20_000, 100_000) if large else _log_uniform(rng, 40, 4000))
    tests = round(_log_uniform(rng, 1, 60))
    layout = str(rng.choice(LAYOUTS, p=[0.35, 0.35, 0.2, 0.1]))
    both_directions = layout in ("two columns", "signed")
    mixed = both_directions and bool(tests < 2 or rng.random() < 0.4)
    samples = max(samples, round((SHORTEST_BOTH_S if mixed else SHORTEST_S) / clock.step_s))
    tests = max(1, min(tests, (LARGE_SAMPLES if large else TYPICAL_SAMPLES) // samples))
    shapes = [str(name) for name in rng.choice(list(SHAPES), int(rng.integers(1, 4)), replace=False)]
    # A ramp is a static test: no model can be had of ramps alone.
    shapes = [name for name in shapes if name != "ramp"] + ["ramp"] * ("ramp" in shapes and tests > 5)
    schedule = Schedule(
        tests,
        samples,
        tuple(shapes) if set(shapes) - {"ramp"} else ("PRBS", *shapes),
        mixed,
        bool(rng.random() < 0.15),
        float(rng.uniform(0.02, 0.15)) if rng.random() < 0.3 else 0.0,
        str(rng.choice(DEFECTS)) if tests >= 4 and rng.random() < 0.35 else "",
        str(rng.choice(["no motion", "below the dead zone"])) if rng.random() < 0.12 else "",
    )
    return schedule, layout


def _columns(rng: Rng, layout: str) -> Columns:
    signed = layout == "signed"
    return Columns(
        layout,
        str(rng.choice(list(FULL_SCALE))),
        str(rng.choice(list(TRAVEL))),
        zero=float(rng.uniform(-0.3, 0.8)) if signed and rng.random() < 0.5 else 0.0,
        scale=-1.0 if signed and rng.random() < 0.3 else 1.0,
        displacement_scale=float(rng.choice([-1.0, 0.025])) if rng.random() < 0.2 else 1.0,
    )


def _valve(rng: Rng, full: float) -> Valve:
    dead_zone = full * float(rng.uniform(0.05, 0.45)) if rng.random() < 0.7 else 0.0
    kind = rng.choice(["plain", "play", "curve", "saturation"], p=[0.6, 0.15, 0.15, 0.1])
    return Valve(
        dead_zone,
        play=dead_zone * float(rng.uniform(0.05, 0.3)) if kind == "play" else 0.0,
        exponent=float(rng.uniform(0.6, 2.0)) if kind == "curve" else 1.0,
        saturation=float(rng.uniform(0.4, 0.8)) * (full - dead_zone) if kind == "saturation" else np.inf,
        full=full - dead_zone,
    )


def _values(rng: Rng, structure: str, clock: Clock, samples: int) -> dict[str, float]:
    duration_s = samples * clock.step_s
    lag = float(np.clip(_log_uniform(rng, clock.step_s / 2, duration_s / 10), 2e-3, 50.0))
    values: dict[str, float] = {}
    if structure == "integrator-second-order":
        damping = float(rng.choice([rng.uniform(0.2, 0.9), rng.uniform(1.1, 1.8)]))
        values = {"natural_frequency": float(np.clip(1 / lag, 0.6, 800.0)), "damping_ratio": damping}
    elif structure != "integrator":
        values = {"time_constant": max(lag, 0.06) if structure == "first-order-lag" else lag}
    if rng.random() < 0.4:
        values["dead_time"] = float(min(rng.uniform(0.5, 10.0) * clock.step_s, 0.9, duration_s / 10))
    return values


def _sensor(rng: Rng) -> Sensor:
    return Sensor(
        noise=_log_uniform(rng, 1e-4, 0.05) if rng.random() < 0.85 else 0.0,
        quantum=_log_uniform(rng, 5e-4, 0.02) if rng.random() < 0.25 else 0.0,
        drift=float(rng.uniform(-0.05, 0.05)) if rng.random() < 0.12 else 0.0,
        spikes=float(rng.uniform(0.001, 0.01)) if rng.random() < 0.12 else 0.0,
    )
