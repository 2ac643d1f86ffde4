"""Check of the range of a signal for its unit."""

from collections.abc import Callable
from math import pi
from statistics import median_high
from typing import NamedTuple

import numpy as np

from hitchid._support.records import Severity
from hitchid.logs.audit.context import (
    AuditFinding,
    CampaignContext,
    Findings,
    RecordContext,
    travel,
)
from hitchid.logs.not_measured import true_intervals
from hitchid.logs.record import COMMAND, DISPLACEMENT
from hitchid.logs.units import UNITS

# Check for a stuck or saturated sensor: constant displacement although the piston must move.

STUCK_S = 0.5  # s; shortest constant interval (chosen)
STUCK_SAMPLES = 10  # samples; fewest in a constant interval (chosen)
STUCK_TRAVEL_FRACTION = 0.01  # of the range; least travel expected under the command (chosen)
MAX_CHANCE = 1e-9  # largest probability that rounding alone explains the interval (chosen)
FEWEST_AT_REST = 50  # samples at rest needed to estimate the share of repeats (chosen)
MOVING_FRACTION = 0.1  # of working speed; least speed before and after (chosen)
NOISE_SHOWS = 0.5  # σ over the quantum, from which on noise changes readings (chosen)
STRONG = 0.9  # of the median active command; least strong command (chosen)


class _ConstantRun(NamedTuple):
    """Samples `start:stop` in which a displacement is exactly constant although it is commanded to move."""

    test: RecordContext
    start: int
    stop: int
    direction: str
    level: float
    noiseless: bool


def stuck_sensors(context: CampaignContext) -> Findings:
    """Find stuck or saturated sensors: constant although the piston must move.

    A constant run: exactly constant for at least 0.5 s and ten samples under a strong command, the expected
    travel being above 1 % of the range, ten quanta and 20 σ. At an end stop or in the dead zone the sensor's
    noise remains: a run of n samples counts if zⁿ < 10⁻⁹, z being the share of unchanged samples at rest (of
    all samples, if few are at rest and σ is above half a quantum). Where the noise is below the quantum, it
    counts if the displacement moves in the same direction before and after, above a tenth of working speed.
    Two or more runs at the same extreme of all logs are a saturated sensor: a warning, since its samples can
    be left out; others are a stuck sensor: a fault.
    """
    constant_runs = [run for test in context.tests for run in _constant_runs(test)]
    levels = [run.level for run in constant_runs]
    lowest = min(test.quality.lowest for test in context.tests)
    highest = max(test.quality.highest for test in context.tests)
    # Twice at one extreme of all logs is no coincidence of a sensor that stuck.
    at_end = {level for level in (lowest, highest) if levels.count(level) >= 2}
    for test in context.tests:
        runs = [run for run in constant_runs if run.test is test]
        for saturated in (False, True):
            group = [run for run in runs if (run.level in at_end) == saturated]
            if group:
                unit = context.command_unit(group[0].direction)
                yield _constant_finding(test, group, unit, saturated=saturated)


def _constant_finding(
    context: RecordContext, group: list[_ConstantRun], unit: str, *, saturated: bool
) -> AuditFinding:
    record, first = context.record, group[0]
    level = float(np.median(np.abs(record.command(first.direction)[first.start : first.stop])))
    what = (
        f"the displacement is constant at {first.level:.5g} {context.quality.unit} from "
        f"{context.time_s(first.start):.6g} to {context.time_s(first.stop - 1):.6g} s although "
        f"{first.direction} is commanded at {level:.3g} {unit}"
    )
    if len(group) > 1:
        what += f", and {len(group) - 1} more times"
    check, severity = "stuck sensor", Severity.FAULT
    advice = "check the sensor and its cable; cut this interval out, or repeat the test"
    if saturated:
        check, severity, what = "saturated sensor", Severity.WARNING, f"{what}, and again at other times"
        advice = "this is the end of the sensor's range: move the sensor, or keep the tests within its range"
    intervals = [(run.start, run.stop) for run in group]
    return context.finding(check, severity, what, advice, intervals=intervals)


def _constant_runs(context: RecordContext) -> list[_ConstantRun]:
    displacement = context.record.displacement
    repeated = displacement[1:] == displacement[:-1]
    starts, stops = true_intervals(repeated)
    shortest = max(STUCK_SAMPLES, round(min(STUCK_S / context.record.step_s, 1e9)))
    long = stops - starts >= shortest
    if not long.any():
        return []
    stretches = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
    unchanged = _unchanged_share(context, repeated, stretches)
    log_share = np.log(max(unchanged, 1e-12))
    constant_runs: list[_ConstantRun] = []
    for direction in context.record.directions:
        strong = context.active(direction)
        if strong.any():
            command = np.abs(context.record.command(direction))
            strong &= command >= STRONG * np.median(command[strong])
        # Of the same log, so that its own load and oil count.
        speed = _speed(displacement, strong[:-1], repeated)
        for start, stop in stretches:
            level = float(displacement[start])
            for begin, end in zip(*true_intervals(strong[start : stop + 1]), strict=True):
                noiseless = bool((end - begin) * log_share > np.log(MAX_CHANCE))
                run = _ConstantRun(context, start + int(begin), start + int(end), direction, level, noiseless)
                if run.stop - run.start > shortest and _must_move(run, speed, strong):
                    constant_runs.append(run)
    return constant_runs


def _unchanged_share(context: RecordContext, repeated: np.ndarray, stretches: list[tuple[int, int]]) -> float:
    """Return the share of samples equal to the one before: at rest, or overall if noise is visible."""
    resting = ~context.any_active()[:-1]
    quality = context.quality
    if np.count_nonzero(resting) < FEWEST_AT_REST:
        if quality.noise < NOISE_SHOWS * (quality.quantum or 0.0) or quality.noise == 0.0:
            return 1.0
        resting = np.ones(repeated.size, dtype=bool)
        for start, stop in stretches:
            resting[start:stop] = False
    resting_count = int(np.count_nonzero(resting))
    if resting_count < FEWEST_AT_REST:
        return 1.0
    return int(np.count_nonzero(repeated & resting)) / resting_count


def _speed(displacement: np.ndarray, strong: np.ndarray, repeated: np.ndarray) -> float:
    """Return the mean signed motion per sample under a strong command, unchanged samples excluded."""
    moving = strong & ~repeated
    count = int(np.count_nonzero(moving))
    return float(np.sum(np.diff(displacement), where=moving)) / count if count else 0.0


def _must_move(run: _ConstantRun, speed: float, strong: np.ndarray) -> bool:
    """Return whether the piston would have moved, so that the sensor is stuck."""
    quality, samples = run.test.quality, run.stop - run.start
    required_travel = max(
        STUCK_TRAVEL_FRACTION * quality.peak_to_peak, 10 * (quality.quantum or 0.0), 20 * quality.noise
    )
    if not abs(speed) * samples > required_travel:
        return False
    # Noise that stops is proof enough; without noise only motion on both sides is.
    if not run.noiseless:
        return True
    displacement = run.test.record.displacement
    window_start, window_stop = max(0, run.start - samples), min(displacement.size, run.stop + samples)
    if not (strong[max(0, run.start - 2)] and strong[min(strong.size - 1, run.stop + 1)]):
        return False
    travels = np.array([run.level - displacement[window_start], displacement[window_stop - 1] - run.level])
    samples_spent = np.array([run.start - window_start, window_stop - run.stop])
    return bool(
        np.all(travels * np.sign(speed) > MOVING_FRACTION * abs(speed) * samples_spent)
        and np.all(samples_spent > 0)
    )


class _Range(NamedTuple):
    """Lowest and highest number of a signal in all logs: in its unit, and in the SI unit."""

    lowest: float
    highest: float
    si: float

    @property
    def largest(self) -> float:
        return max(abs(self.lowest), abs(self.highest))

    @property
    def span_si(self) -> float:
        return (self.highest - self.lowest) * self.si


class _Rule(NamedTuple):
    """Condition of an implausible range of a unit, or of all units of a dimension, and its probable cause."""

    unit: str
    applies: Callable[[_Range], bool]
    severity: Severity
    suggestion: str


LONGEST_M = 20.0  # m; no lifting cylinder has a longer stroke
SHORTEST_M = 1e-3  # m; shorter strokes are not modelled (chosen)
LARGEST_CURRENT_A = 20.0  # A; coil currents are a few A
SMALLEST_MILLIAMPERE = 5.0  # mA; a lower current opens no valve
LARGEST_PRESSURE_PA = 1000e5  # Pa; above the pressures of hydraulics
LOWEST_PRESSURE_PA = -2e5  # Pa; 2 bar, allowed for a sensor's offset (chosen)
LARGEST_VOLTAGE_V = 100.0  # V; above the signals of a test bench
# Factors between units that a column may have under one name: cm or m and mm, in and mm, rad and deg.
UNIT_FACTORS = (10.0, 100.0, 1000.0, 25.4, 180 / pi)
UNIT_TOLERANCE = 1.5  # times a factor either way; tests at different commands differ too (chosen)
DEAD_ZONE_SHARES = np.linspace(0.0, 0.6, 13)  # of full scale, dead zones that are tried (chosen)
FEWEST_TO_COMPARE = 3  # tests of a direction (chosen)
OVERDRIVE = 1.05  # of full scale, 5 % tolerance (chosen)

PLAUSIBILITY_RULES = (
    _Rule("length", lambda r: r.span_si > LONGEST_M, Severity.FAULT, "a smaller unit, such as mm"),
    _Rule(
        "length",
        lambda r: 0 < r.span_si < SHORTEST_M,
        Severity.WARNING,
        "a larger unit, such as m, or a piston that does not move",
    ),
    _Rule("rad", lambda r: r.largest > 2 * pi, Severity.WARNING, "degrees"),
    _Rule("deg", lambda r: r.largest > 360.0, Severity.WARNING, "a raw count, or an encoder overflow"),
    _Rule("deg", lambda r: 0 < r.largest <= 2 * pi, Severity.NOTE, "radians"),
    _Rule("1", lambda r: r.largest > OVERDRIVE, Severity.WARNING, "percent"),
    _Rule("percent", lambda r: r.largest > 100 * OVERDRIVE, Severity.WARNING, "a raw count, not percent"),
    _Rule("percent", lambda r: 0 < r.largest <= 1, Severity.WARNING, "a fraction, in unit 1"),
    _Rule("A", lambda r: r.largest > LARGEST_CURRENT_A, Severity.FAULT, "mA"),
    _Rule("mA", lambda r: 0 < r.largest <= SMALLEST_MILLIAMPERE, Severity.WARNING, "A"),
    _Rule("voltage", lambda r: r.largest > LARGEST_VOLTAGE_V, Severity.WARNING, "mV"),
    _Rule(
        "pressure",
        lambda r: r.highest * r.si > LARGEST_PRESSURE_PA or r.lowest * r.si < LOWEST_PRESSURE_PA,
        Severity.WARNING,
        "another unit of pressure, or an offset of the sensor",
    ),
)


def units(context: CampaignContext) -> Findings:
    """Find signals whose range over all logs is implausible for their unit; nothing is converted.

    The limits: a stroke is below 20 m and above 1 mm; a coil current is a few A, so above 20 A the unit is
    mA, and below 5 mA no valve opens; a joint turns within ±360°; a ratio is at most 1 or 100 percent, with 5
    % tolerance; a pressure is below 1000 bar and above −2 bar, a sensor's offset; a voltage is below 100 V.
    An impossible range is a fault, an unlikely one a warning. A covariate above 1 in unit 1 probably was
    given no unit: a note.
    """
    for role in dict.fromkeys(role for test in context.tests for role in test.record.signals):
        records = [test.record for test in context.tests if role in test.record.signals]
        unit = records[0].units[role]
        lowest = float(min(record.signals[role].min() for record in records))
        highest = float(max(record.signals[role].max() for record in records))
        extent = _Range(lowest, highest, UNITS[unit].factor)
        causes = [rule for rule in PLAUSIBILITY_RULES if rule.unit in (unit, UNITS[unit].dimension)]
        judged = [(r.severity, f"this is probably {r.suggestion}") for r in causes if r.applies(extent)]
        if role != DISPLACEMENT and role not in COMMAND.values():
            # A covariate may be small, or have no stated unit.
            if UNITS[unit].dimension in ("length", "ratio"):
                judged = []
            if unit == "1" and extent.largest > OVERDRIVE:
                judged = [(Severity.NOTE, "its unit is probably missing")]
        for severity, judgement in judged:
            what = (
                f"{role} ranges from {lowest:.4g} to {highest:.4g} in all logs and has the unit '{unit}': "
                f"{judgement}"
            )
            advice = "check the unit of this column in campaign.toml; no value was converted"
            yield context.finding("units", severity, what, advice, signal=role)


def units_of_logs(context: CampaignContext, direction: str) -> Findings:
    """Find logs whose unit is another than that of most logs, under the same name: a fault.

    Of each test the travel per command beyond the dead zone and time is compared with the median of its
    direction: a tenth, or another factor between two units, is no difference between tests of one plant.
    """
    moving = [test for test in context.tests if abs(travel(test, direction)) > test.quality.noise_bound]
    if len(moving) < FEWEST_TO_COMPARE:
        return
    # Of several dead zones the one behind which most tests travel alike.
    commands = [np.abs(test.record.command(direction)) for test in moving]
    zones = DEAD_ZONE_SHARES * context.scales[direction]
    areas = np.array(
        [[max(float(np.sum(np.maximum(c - zone, 0.0))), 1e-9) for c in commands] for zone in zones]
    )
    ways = [abs(travel(test, direction)) / test.record.step_s for test in moving]
    logarithms = np.log(ways / areas)
    medians = np.median(logarithms, axis=1, keepdims=True)
    best = int(np.argmin(np.median(np.abs(logarithms - medians), axis=1)))
    gains = np.exp(logarithms[best])
    usual = median_high(gains.tolist())
    for test, gain in zip(moving, gains.tolist(), strict=True):
        ratio = max(usual / gain, gain / usual)
        factor = min(UNIT_FACTORS, key=lambda factor: abs(np.log(ratio / factor)))
        if abs(np.log(ratio / factor)) > np.log(UNIT_TOLERANCE):
            continue
        share = f"{factor:.4g} times {'less' if gain < usual else 'more'} than"
        what = (
            f"the piston travels about {share} in most {direction} tests for the same command: the "
            f"log is probably not in {test.quality.unit}, or its command has another unit"
        )
        advice = "put logs in other units into a folder of their own, with a campaign.toml for them"
        yield test.finding("units", Severity.FAULT, what, advice)
