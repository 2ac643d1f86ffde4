"""Check of the range of a signal for its unit."""

from collections.abc import Callable
from math import pi
from statistics import median_high
from typing import NamedTuple

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, travel
from hitchid.audit.finding import AuditFinding
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.data.units import UNITS


class _SignalRange(NamedTuple):
    """Lowest and highest number of a signal in all logs, and its unit."""

    lowest: float
    highest: float
    unit: str

    @property
    def largest(self) -> float:
        return max(abs(self.lowest), abs(self.highest))

    @property
    def peak_to_peak(self) -> float:
        return self.highest - self.lowest

    @property
    def si(self) -> float:
        """Factor to the SI unit."""
        return UNITS[self.unit].factor


class _PlausibilityRule(NamedTuple):
    """Condition of an implausible range, and its probable cause."""

    dimension: str
    applies: Callable[[_SignalRange], bool]
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

_POSITION = (
    _PlausibilityRule(
        "length", lambda r: r.peak_to_peak * r.si > LONGEST_M, Severity.FAULT, "a smaller unit, such as mm"
    ),
    _PlausibilityRule(
        "length",
        lambda r: 0 < r.peak_to_peak * r.si < SHORTEST_M,
        Severity.WARNING,
        "a larger unit, such as m, or a piston that does not move",
    ),
)
_ANGLE = (
    _PlausibilityRule("angle", lambda r: r.unit == "rad" and r.largest > 2 * pi, Severity.WARNING, "degrees"),
    _PlausibilityRule(
        "angle",
        lambda r: r.unit == "deg" and r.largest > 360.0,
        Severity.WARNING,
        "a raw count, or an encoder overflow",
    ),
    _PlausibilityRule(
        "angle", lambda r: r.unit == "deg" and 0 < r.largest <= 2 * pi, Severity.NOTE, "radians"
    ),
)
_RATIO = (
    _PlausibilityRule(
        "ratio", lambda r: r.unit == "1" and r.largest > OVERDRIVE, Severity.WARNING, "percent"
    ),
    _PlausibilityRule(
        "ratio",
        lambda r: r.unit == "percent" and r.largest > 100 * OVERDRIVE,
        Severity.WARNING,
        "a raw count, not percent",
    ),
    _PlausibilityRule(
        "ratio",
        lambda r: r.unit == "percent" and 0 < r.largest <= 1,
        Severity.WARNING,
        "a fraction, in unit 1",
    ),
)
_ELECTRIC = (
    _PlausibilityRule(
        "current", lambda r: r.unit == "A" and r.largest > LARGEST_CURRENT_A, Severity.FAULT, "mA"
    ),
    _PlausibilityRule(
        "current",
        lambda r: r.unit == "mA" and 0 < r.largest <= SMALLEST_MILLIAMPERE,
        Severity.WARNING,
        "A",
    ),
    _PlausibilityRule("voltage", lambda r: r.largest > LARGEST_VOLTAGE_V, Severity.WARNING, "mV"),
)
_PRESSURE = (
    _PlausibilityRule(
        "pressure",
        lambda r: r.highest * r.si > LARGEST_PRESSURE_PA or r.lowest * r.si < LOWEST_PRESSURE_PA,
        Severity.WARNING,
        "another unit of pressure, or an offset of the sensor",
    ),
)
PLAUSIBILITY_RULES = (*_POSITION, *_ANGLE, *_RATIO, *_ELECTRIC, *_PRESSURE)


def units(context: CampaignContext) -> list[AuditFinding]:
    """Find signals whose range over all logs is implausible for their unit; nothing is converted.

    The limits: a stroke is below 20 m and above 1 mm; a coil current is a few A, so above 20 A the unit is
    mA, and below 5 mA no valve opens; a joint turns within ±360°; a ratio is at most 1 or 100 percent, with 5
    % tolerance; a pressure is below 1000 bar and above −2 bar, a sensor's offset; a voltage is below 100 V.
    An impossible range is a fault, an unlikely one a warning. A covariate above 1 in unit 1 probably was
    given no unit: a note.
    """
    findings = []
    roles = dict.fromkeys(role for test in context.tests for role in test.record.signals)
    for role in roles:
        signal_range = _signal_range(context, role)
        is_covariate = role != DISPLACEMENT and role not in COMMAND.values()
        for rule in PLAUSIBILITY_RULES:
            if rule.dimension != UNITS[signal_range.unit].dimension or not rule.applies(signal_range):
                continue
            if is_covariate and rule.dimension in ("length", "ratio"):
                continue  # a covariate may be small, or have no stated unit
            findings.append(
                _finding(role, signal_range, rule.severity, f"this is probably {rule.suggestion}")
            )
        if is_covariate and signal_range.unit == "1" and signal_range.largest > OVERDRIVE:
            findings.append(_finding(role, signal_range, Severity.NOTE, "its unit is probably missing"))
    return findings


def units_of_logs(context: CampaignContext) -> list[AuditFinding]:
    """Find logs whose unit is another than that of most logs, under the same name: a fault.

    Of each test the travel per command beyond the dead zone and time is compared with the median of its
    direction: a tenth, or another factor between two units, is no difference between tests of one plant.
    """
    findings = []
    for direction in DIRECTIONS:
        tests = [test for test in context.tests if direction in test.record.directions]
        moving = [test for test in tests if abs(travel(test, direction)) > test.quality.noise_bound]
        if len(moving) < FEWEST_TO_COMPARE:
            continue
        # Of several dead zones the one behind which most tests travel alike.
        commands = [np.abs(test.record.command(direction)) for test in moving]
        areas = np.array(
            [
                [
                    max(float(np.sum(np.maximum(c - share * context.scales[direction], 0.0))), 1e-9)
                    for c in commands
                ]
                for share in DEAD_ZONE_SHARES
            ]
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
            findings.append(
                test.finding(
                    "units",
                    Severity.FAULT,
                    f"the piston travels about {share} in most {direction} tests for the same command: the "
                    f"log is probably not in {test.quality.unit}, or its command has another unit",
                    "put logs in other units into a folder of their own, with a campaign.toml for them",
                )
            )
    return findings


def _signal_range(context: CampaignContext, role: str) -> _SignalRange:
    present = [test.record for test in context.tests if role in test.record.signals]
    arrays = [record.signals[role] for record in present]
    return _SignalRange(
        float(min(array.min() for array in arrays)),
        float(max(array.max() for array in arrays)),
        present[0].units[role],
    )


def _finding(role: str, signal_range: _SignalRange, severity: Severity, judgement: str) -> AuditFinding:
    what = (
        f"{role} ranges from {signal_range.lowest:.4g} to {signal_range.highest:.4g} in all logs "
        f"and has the unit '{signal_range.unit}': {judgement}"
    )
    return AuditFinding(
        "units",
        severity,
        "",
        role,
        (),
        what,
        "check the unit of this column in campaign.toml; no value was converted",
    )
