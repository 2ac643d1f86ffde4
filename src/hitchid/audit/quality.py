"""Quality of a record's displacement: sampling, range, quantum and noise."""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from hitchid._support.short_repr import short_repr
from hitchid.data.record import Record
from hitchid.data.resampling import GRID_TOLERANCE

MAX_SAMPLES = 2**20  # samples examined, to limit time and memory (chosen)
GRID_DEVIATION = 0.05  # of the quantum; largest distance from the grid (chosen)
FEWEST_VALUES = 3  # distinct values that make a grid (chosen)
MAX_STEPS = 1e7  # quanta in the range; a smaller quantum is rounding of a float
MIN_TURNS = 10  # starts and stops; with fewer, motion may be at one constant speed (chosen)
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

    Args:
        record: any record.

    Returns:
        Figures in the record's own units.
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
    low, width = (median - quantum / 2, quantum) if median > quantum / 2 else (0.0, quantum / 2)
    below = float(np.mean(second_difference < median - quantum / 2))
    on = float(np.mean(np.abs(second_difference - median) < quantum / 2))
    median = low + width * (0.5 - below) / on
    spread = median / NORMAL_MEDIAN / SECOND_DIFFERENCE
    return float(np.sqrt(max(0.0, spread * spread - quantum * quantum / 12)))
