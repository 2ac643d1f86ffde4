"""A campaign of made-up logs from a seed, with the truth behind it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .commands import SHAPES, alternating, start_at_rest
from .design import Design, Schedule, draw_design
from .plants import Controller, Plant

Rng = np.random.Generator
UNSEEN_TESTS = 2
SAME_SPEED = 0.02


@dataclass(frozen=True)
class Truth:
    """What is behind the logs of one campaign.

    Attributes:
        seed: it was drawn from.
        logs, unseen: folders of the campaign, and of further tests of the same plant.
        description: what it is, for a table.
        unusable: why no model can be had; empty where one can.
        values: direction to parameter to its value, in hitchid's parametrisation and the log's units; empty
            where the plant, its clock or its sensor is not among what hitchid chooses from.
        slack_s: what jitter of the clock may shift a time by.
        travel: largest range of displacement of a test.
    """

    seed: int
    logs: Path
    unseen: Path
    description: str
    unusable: str
    values: dict[str, dict[str, float]]
    slack_s: float
    travel: float


@dataclass(frozen=True)
class _Test:
    """One test before it is run: its sign (0 both ways), its commands where no controller gives them."""

    name: str
    sign: int
    command: np.ndarray
    load: float
    defect: str = ""


def draw(seed: int, folder: Path) -> Truth:
    """Draw a campaign from a seed, and write it.

    Args:
        seed: everything comes from it.
        folder: gets `logs` and `fresh`, folders of CSV logs with a `campaign.toml` each.
    """
    design = draw_design(seed)
    rng = np.random.default_rng([seed, 1])
    tests = [_plan_test(rng, design, number) for number in range(design.schedule.tests)]
    unseen_tests = [
        _plan_test(rng, replace(design, schedule=_defect_free(design)), number)
        for number in range(UNSEEN_TESTS)
    ]
    gains = _gains(rng, design, tests)
    plant = design.plant(gains)
    travel = _write(rng, design, plant, tests, folder / "logs")
    _write(rng, design, plant, unseen_tests, folder / "fresh")
    return Truth(
        seed,
        folder / "logs",
        folder / "fresh",
        describe(design),
        design.schedule.unusable,
        _values(design, gains, {test.sign for test in tests}),
        design.clock.step_s if design.clock.jitter else 0.0,
        travel,
    )


def describe(design: Design) -> str:
    """Return what a campaign is in a line."""
    schedule, columns, clock = design.schedule, design.columns, design.clock
    valve = design.valves[0]
    items = [
        design.structure,
        "dead time" if "dead_time" in design.values else "",
        "dead zone" if valve.dead_zone else "",
        "play" if valve.play else "",
        "curve" if valve.exponent != 1 else "",
        "saturation" if valve.saturation < np.inf else "",
        "stops" if design.stops else "",
        "load scatter" if schedule.scatter else "",
        f"{schedule.tests} x {schedule.samples} every {clock.step_s:g} s",
        f"jitter {clock.jitter:.0%}" if clock.jitter else "",
        f"{clock.gaps} gaps" if clock.gaps else "",
        f"{columns.displacement_unit} over {columns.command_unit}",
        columns.layout,
        f"zero {columns.zero:g}" if columns.zero else "",
        "turned sign" if min(columns.scale, columns.displacement_scale) < 0 else "",
        "closed loop" if schedule.closed_loop else " and ".join(schedule.shapes),
        "both ways" if schedule.mixed else "",
        f"noise {design.sensor.noise:.2%}",
        "drift" if design.sensor.drift else "",
        "spikes" if design.sensor.spikes else "",
        f"one test {schedule.defect}" if schedule.defect else "",
        f"unusable: {schedule.unusable}" if schedule.unusable else "",
    ]
    return ", ".join(item for item in items if item)


def _defect_free(design: Design) -> Schedule:
    """Return the schedule of tests that nothing is wrong with."""
    return replace(design.schedule, defect="", shapes=tuple(s for s in design.schedule.shapes if s != "ramp"))


def _plan_test(rng: Rng, design: Design, number: int) -> _Test:
    schedule, layout = design.schedule, design.columns.layout
    sign = {"lifting": 1, "lowering": -1}.get(layout, 1 if number % 2 == 0 else -1)
    dead_zone = design.valves[0 if sign > 0 else 1].dead_zone / design.full
    levels = (dead_zone + 0.15 * (1 - dead_zone), 1.0)
    defect = schedule.defect if number == schedule.tests // 2 else ""
    if schedule.unusable == "below the dead zone" or defect == "without motion":
        levels = (0.3 * dead_zone, 0.8 * dead_zone)
    shape = schedule.shapes[(number // 2 if not schedule.mixed else number) % len(schedule.shapes)]
    if schedule.mixed:
        command = alternating(rng, schedule.samples, levels, shape)
    else:
        command = sign * SHAPES[shape](rng, schedule.samples, levels)
    load = float(np.exp(schedule.scatter * rng.standard_normal()))
    if schedule.unusable == "no motion":
        load = 0.0
    return _Test(
        f"test-{number + 1:02d}",
        0 if schedule.mixed else sign,
        design.full * start_at_rest(command),
        load,
        defect,
    )


def _gains(rng: Rng, design: Design, tests: list[_Test]) -> tuple[float, float]:
    """Return speeds per command with which the longest way fills the travel, or goes beyond its stops."""
    flows = [
        np.array([design.valves[0 if c > 0 else 1].flow(abs(c)) * np.sign(c) for c in test.command])
        for test in tests
    ]
    lag = design.values["time_constant"] if design.structure == "first-order-lag" else np.inf
    largest_travel = max(
        min(float(np.ptp(np.cumsum(flow))) * design.clock.step_s, lag * float(np.ptp(flow))) for flow in flows
    )
    share = rng.uniform(1.1, 1.5) if design.stops else rng.uniform(0.3, 1.0)
    gain = float(share * design.travel / largest_travel) if largest_travel else design.travel / design.full
    return gain, gain * float(rng.uniform(0.7, 1.3))


def _write(rng: Rng, design: Design, plant: Plant, tests: list[_Test], folder: Path) -> float:
    """Run tests and write their logs; return the largest travel of one."""
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text(design.columns.settings(), encoding="utf-8")
    runs = []
    for test in tests:
        time_s = design.clock.stamps(rng, design.schedule.samples)
        start = {1: 0.0, -1: design.travel, 0: design.travel / 2}[test.sign]
        if test.defect == "at the stop":
            start = design.travel if test.sign >= 0 else 0.0
        commands = _controller(rng, design, plant, test) if _is_closed_loop(design, test) else test.command
        runs.append((test, time_s, *plant.run(time_s, commands, start, test.load)))
    travel = max(float(np.ptp(displacement)) for _, _, displacement, _ in runs) or design.travel
    for test, time_s, displacement, command in runs:
        present = design.clock.present(rng, time_s.size)
        sensor = replace(design.sensor, ceiling=0.7) if test.defect == "saturated" else design.sensor
        logged = sensor.measure(rng, displacement, travel)
        design.columns.write(folder / f"{test.name}.csv", time_s[present], command[present], logged[present])
    return travel


def _is_closed_loop(design: Design, test: _Test) -> bool:
    return design.schedule.closed_loop and not design.schedule.unusable and not test.defect


def _controller(rng: Rng, design: Design, plant: Plant, test: _Test) -> Controller:
    """Return a proportional controller with a jump over the dead zone, on a reference in steps."""
    values, samples = design.values, design.schedule.samples
    time_scale = design.clock.step_s + values.get("dead_time", 0.0) + values.get("time_constant", 0.0)
    time_scale += 2 * values.get("damping_ratio", 0.0) / values.get("natural_frequency", 1.0)
    factor = min(4 * design.full / design.travel, 0.4 / (max(plant.gains) * time_scale))
    count = int(rng.integers(3, 9))
    targets = rng.uniform(0.1, 0.9, count) if test.sign == 0 else np.linspace(0.1, 0.9, count)
    targets = targets[:: test.sign or 1] * design.travel
    lowest, highest = {1: (0.0, 1.0), -1: (-1.0, 0.0), 0: (-1.0, 1.0)}[test.sign]

    def command(number: int, displacement: float) -> float:
        error = targets[min(number * count // samples, count - 1)] - displacement
        if number < 2 or abs(error) < SAME_SPEED * design.travel:
            return 0.0
        jump = design.valves[0 if error > 0 else 1].dead_zone
        demand = factor * error + np.sign(error) * jump
        return float(np.clip(demand, lowest * design.full, highest * design.full))

    return command


def _values(design: Design, gains: tuple[float, float], signs: set[int]) -> dict[str, dict[str, float]]:
    """Return what hitchid should find, where it can choose what is true."""
    schedule, sensor, clock = design.schedule, design.sensor, design.clock
    outside_model_class = (
        design.structure == "first-order-lag"
        or design.stops
        or schedule.mixed
        or schedule.scatter
        or schedule.unusable
        or schedule.defect == "saturated"
        or sensor.drift
        or sensor.spikes
        or clock.gaps
    )
    if outside_model_class:
        return {}
    expected = {}
    for sign, direction, valve, gain in zip(
        (1, -1), ("lifting", "lowering"), design.valves, gains, strict=True
    ):
        if sign in signs and valve.saturation == np.inf:
            # The power of an opening curve changes what a gain is measured in.
            valve_parameters = {"exponent": valve.exponent} if valve.exponent != 1 else {"gain": gain}
            expected[direction] = {**valve_parameters, "dead_zone": valve.dead_zone, **design.values}
    return expected
