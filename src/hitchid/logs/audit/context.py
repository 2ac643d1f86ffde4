"""Input of the checks: a record with its quality, and the campaign."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np

from hitchid._support.records import Severity, short_repr
from hitchid.logs.campaign import Campaign
from hitchid.logs.kinds import ACTIVE_FRACTION, full_scales, ramp_direction
from hitchid.logs.record import COMMAND, DISPLACEMENT, RAMP, Record
from hitchid.logs.resampling import GRID_TOLERANCE

# Findings of an audit, and the time intervals they concern.

MAX_SPANS = 50  # intervals listed in one finding (chosen)


@short_repr
@dataclass(frozen=True)
class AuditFinding:
    """One finding of an audit.

    Attributes:
        check: short name of the check.
        severity: `FAULT` (a model from this would be wrong), `WARNING` or `NOTE`.
        record: name of the record; empty for several or all.
        signal: role of the signal; empty for none or several.
        spans: intervals (start, stop) in s of the log's own time; empty for the whole log.
        what: the fault, with numbers and units.
        advice: the remedy, or what to measure again.
        merged: the findings on single records that were merged into this one.
    """

    check: str
    severity: Severity
    record: str
    signal: str
    spans: tuple[tuple[float, float], ...]
    what: str
    advice: str
    merged: tuple["AuditFinding", ...] = ()

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records concerned; empty for the whole campaign."""
        names = [self.record] if self.record else [finding.record for finding in self.merged]
        return tuple(dict.fromkeys(names))

    @property
    def locations(self) -> tuple[tuple[str, float, float], ...]:
        """Intervals as record, start and stop in s of its own time; empty for whole records."""
        return tuple((finding.record, *span) for finding in (self, *self.merged) for span in finding.spans)

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        return {
            "check": self.check,
            "level": self.severity.value,
            "records": list(self.records),
            "signal": self.signal,
            "places": [
                {"record": record, "start_s": start, "stop_s": stop} for record, start, stop in self.locations
            ],
            "what": self.what,
            "advice": self.advice,
        }


Findings = Iterator[AuditFinding]  # what every check yields


# Quality of a record's displacement: sampling, range, quantum and noise.

MAX_SAMPLES = 2**20  # samples examined, to limit time and memory (chosen)
GRID_DEVIATION = 0.05  # of the quantum; largest distance from the grid (chosen)
FEWEST_VALUES = 3  # distinct values that make a grid (chosen)
MAX_STEPS = 1e7  # quanta in the range; a smaller quantum is rounding of a float
MIN_TURNS = 10  # starts and stops; with fewer, motion may be at one constant speed (chosen)
FAST_FRACTION = 0.99  # quantile of one-step motions; the rest may be spikes (chosen)
# Median of |x| and standard deviation of second differences of white normal noise x of unit variance.
NORMAL_MEDIAN = 0.6744897501960817
SECOND_DIFFERENCE = 6.0**0.5


@short_repr
@dataclass(frozen=True)
class Quality:
    """Quality of a record's displacement, in its own unit.

    Attributes:
        samples: number of samples.
        step_s: sampling time, s.
        duration_s: from the first to the last sample, s.
        jitter: largest deviation of the log's clock, as a fraction of the sampling time; None
            where the clock was regular.
        unit: the displacement's unit.
        lowest, highest: its range.
        quantum: resolution of the samples; None where they are not quantised.
        noise: standard deviation of its white noise without the rounding.
    """

    samples: int
    step_s: float
    duration_s: float
    jitter: float | None
    unit: str
    lowest: float
    highest: float
    quantum: float | None
    noise: float

    @property
    def peak_to_peak(self) -> float:
        """Difference of the highest and the lowest displacement."""
        with np.errstate(over="ignore"):
            return float(np.float64(self.highest) - np.float64(self.lowest))

    @property
    def noise_bound(self) -> float:
        """Upper bound of noise and rounding: 6 σ + 2 q, in the displacement's unit."""
        return 6.0 * self.noise + 2.0 * (self.quantum or 0.0)

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        values = {**vars(self), "reach": self.peak_to_peak}
        return {
            name: None if isinstance(value, float) and not isfinite(value) else value
            for name, value in values.items()
        }


def quality(record: Record) -> Quality:
    """Return the quality of a record's displacement.

    With d²y = y[k+1] − 2 y[k] + y[k−1], the noise is σ² = (median|d²y| / 0.6745)² / 6 − q²/12: motion is
    smooth from sample to sample, white noise is not, and rounding to a step q adds q²/12. Filtered
    (coloured) noise is underestimated.
    """
    displacement = record.displacement
    with np.errstate(all="ignore"):
        quantum = _quantum(displacement)
        noise = _noise(displacement, quantum)
    return Quality(
        samples=len(record),
        step_s=record.step_s,
        duration_s=(len(record) - 1) * record.step_s,
        jitter=record.clock.jitter if record.clock.jitter > GRID_TOLERANCE else None,
        unit=record.unit,
        lowest=float(displacement.min()),
        highest=float(displacement.max()),
        quantum=quantum,
        noise=noise if isfinite(noise) else 0.0,
    )


def _quantum(displacement: np.ndarray) -> float | None:
    """Return the step of the grid on which all displacements lie, None where there is none."""
    values = np.unique(displacement[:: -(-displacement.size // MAX_SAMPLES)])
    double = np.finfo(float)
    rounding = 16 * double.eps * max(abs(float(values[0])), abs(float(values[-1])))
    rounding = max(rounding, float(double.tiny))  # half of a smaller step may be zero
    gaps = np.diff(values)
    gaps = gaps[gaps > rounding]
    if gaps.size < FEWEST_VALUES - 1:
        return None
    # The mean of all smallest gaps has less error than one of them after a conversion or rounding.
    step = float(np.mean(gaps[gaps < 1.5 * gaps.min()]))
    grid_positions = (values - values[0]) / step
    deviation = float(np.max(np.abs(grid_positions - np.rint(grid_positions))))
    if not (grid_positions[-1] < MAX_STEPS and deviation < GRID_DEVIATION):
        return None
    # Fewer than ten values may lie on a grid by chance, unless each occurs often.
    may_be_chance = values.size < 10 and displacement.size < 5 * values.size
    return None if may_be_chance or _is_steady(displacement[:MAX_SAMPLES], step) else step


def _is_steady(displacement: np.ndarray, step: float) -> bool:
    """Return whether motion is at one constant speed; its samples lie on a grid without rounding."""
    steps = np.abs(np.diff(displacement)) / step
    moving = steps > 0.5
    several_speeds = bool(np.any(steps[moving] > 1.5)) and bool(np.any(np.diff(np.sort(steps[moving])) > 0.5))
    return not several_speeds and int(np.count_nonzero(np.diff(moving))) < MIN_TURNS


def _noise(displacement: np.ndarray, quantum: float | None) -> float:
    if displacement.size < 5:
        return 0.0
    second_difference = displacement[2:] - displacement[1:-1]
    second_difference -= displacement[1:-1]
    second_difference += displacement[:-2]
    np.abs(second_difference, out=second_difference)
    second_difference.partition(second_difference.size // 2)
    median = float(second_difference[second_difference.size // 2])
    if quantum is None:
        return median / NORMAL_MEDIAN / SECOND_DIFFERENCE
    # The median of rounded values is itself rounded: values of one step are taken as uniform over it.
    # A magnitude below half a step is rounded to zero: that level is half as wide.
    low, width = (median - quantum / 2, quantum) if median > quantum / 2 else (0.0, quantum / 2)
    below = float(np.mean(second_difference < median - quantum / 2))
    on = float(np.mean(np.abs(second_difference - median) < quantum / 2))
    median = low + width * (0.5 - below) / on
    spread = median / NORMAL_MEDIAN / SECOND_DIFFERENCE
    return float(np.sqrt(max(0.0, spread * spread - quantum * quantum / 12)))


def fast_step(steps: np.ndarray) -> float:
    """Return the 99th percentile of the magnitude of one-step motions."""
    # One of the samples, not a value between two: the next larger one may be a spike.
    return float(np.quantile(np.abs(steps), FAST_FRACTION, method="lower"))


@dataclass(frozen=True, eq=False)
class RecordContext:
    """A record, its quality, and the scales of its campaign.

    Attributes:
        record: the record.
        scales: direction to full scale, the largest command of the campaign.
        campaign_range: range of all displacements of the campaign, in their unit.
        quality: of the record's displacement.
    """

    record: Record
    scales: Mapping[str, float]
    campaign_range: float
    quality: Quality

    def active(self, direction: str) -> np.ndarray:
        """Return where a direction's command is above 5 % of full scale, shape [N]."""
        return np.abs(self.record.command(direction)) > ACTIVE_FRACTION * self.scales[direction]

    def any_active(self) -> np.ndarray:
        """Return where any command is above 5 % of full scale, shape [N]."""
        return np.logical_or.reduce([self.active(direction) for direction in self.record.directions])

    def finding(
        self,
        check: str,
        severity: Severity,
        what: str,
        advice: str,
        *,
        signal: str = DISPLACEMENT,
        intervals: Iterable[tuple[int, int]] = (),
    ) -> AuditFinding:
        """Return a finding about this record, at samples `start:stop`; at most the 50 longest intervals."""
        selected = list(intervals)
        if len(selected) > MAX_SPANS:
            selected = sorted(sorted(selected, key=lambda interval: interval[0] - interval[1])[:MAX_SPANS])
        times = [(self.time_s(start), self.time_s(int(stop) - 1)) for start, stop in selected]
        # JSON has no infinite times: such a finding is about the whole record.
        spans = tuple((round(a, 6), round(b, 6)) for a, b in times if isfinite(a) and isfinite(b))
        return AuditFinding(check, severity, self.record.name, signal, spans, what, advice)

    def time_s(self, sample: int | np.integer) -> float:
        """Return the time of a sample on the log's own clock, s."""
        return self.record.start_s + int(sample) * self.record.step_s


@dataclass(frozen=True, eq=False)
class CampaignContext:
    """A campaign with the context of each record, in the campaign's order."""

    campaign: Campaign
    tests: tuple[RecordContext, ...]
    scales: Mapping[str, float]
    campaign_range: float

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that have a command, the same in every record of a campaign."""
        return self.campaign.records[0].directions

    def of_kind(self, kind: str) -> list[RecordContext]:
        """Return the contexts of the records of one kind."""
        return [test for test in self.tests if test.record.kind == kind]

    def ramps(self, direction: str) -> list[RecordContext]:
        """Return the contexts of the slow ramps that excite a direction."""
        return [test for test in self.of_kind(RAMP) if ramp_direction(test.record) == direction]

    def command_unit(self, direction: str) -> str:
        """Return the unit of a direction's command as printed after a number."""
        unit = self.campaign.units[COMMAND[direction]]
        return {"1": "(full = 1)", "percent": "%"}.get(unit, unit)

    def finding(
        self, check: str, severity: Severity, what: str, advice: str, *, signal: str = DISPLACEMENT
    ) -> AuditFinding:
        """Return a finding about the whole campaign."""
        return AuditFinding(check, severity, "", signal, (), what, advice)


def campaign_context(campaign: Campaign) -> CampaignContext:
    """Return the context of a campaign with at least one record."""
    scales = full_scales(campaign.records)
    qualities = [quality(record) for record in campaign.records]
    # Of all logs: what is coarse or noisy is so beside the whole stroke, not beside one short test.
    lowest = min(test_quality.lowest for test_quality in qualities)
    campaign_range = float(np.float64(max(test_quality.highest for test_quality in qualities)) - lowest)
    tests = tuple(
        RecordContext(record, scales, campaign_range, test_quality)
        for record, test_quality in zip(campaign.records, qualities, strict=True)
    )
    return CampaignContext(campaign, tests, scales, campaign_range)


def travel(context: RecordContext, direction: str) -> float:
    """Return the travel while only one direction's command is active, in the displacement's unit.

    Σ sign(c[k]) (y[k+1] − y[k]) over those samples; a negative command of a single channel is the
    opposite direction.
    """
    record = context.record
    only_active = context.active(direction)
    for other in record.directions:
        if other != direction:
            only_active &= ~context.active(other)
    # The command at a sample moves the piston until the next one.
    signs = np.sign(record.command(direction)[:-1])
    signs *= only_active[:-1]
    # Two scalar products need no array of differences.
    signed_travel = np.dot(signs, record.displacement[1:]) - np.dot(signs, record.displacement[:-1])
    return float(signed_travel) if np.isfinite(signed_travel) else 0.0


def join_names(names: list[str], shown: int = 3) -> str:
    """Return the first names, joined by commas."""
    return ", ".join(names[:shown]) + (" …" if len(names) > shown else "")
