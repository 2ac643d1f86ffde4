"""Check for a stuck or saturated sensor: constant displacement although the piston must move."""

from typing import NamedTuple

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext, command_unit
from hitchid.audit.finding import AuditFinding, true_intervals

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


def stuck_sensors(context: CampaignContext) -> list[AuditFinding]:
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
    lowest = min(test.quality.lowest for test in context.tests)
    highest = max(test.quality.highest for test in context.tests)
    findings = []
    for test in context.tests:
        for saturated in (False, True):
            group = [
                run
                for run in constant_runs
                if run.test is test and _is_saturated(run, constant_runs, (lowest, highest)) == saturated
            ]
            if group:
                findings.append(_constant_finding(test, group, saturated=saturated))
    return findings


def _is_saturated(run: _ConstantRun, constant_runs: list[_ConstantRun], ends: tuple[float, float]) -> bool:
    return run.level in ends and sum(other.level == run.level for other in constant_runs) >= 2


def _constant_finding(context: RecordContext, group: list[_ConstantRun], *, saturated: bool) -> AuditFinding:
    record, first = context.record, group[0]
    level = float(np.median(np.abs(record.command(first.direction)[first.start : first.stop])))
    begin, end = (record.start_s + sample * record.step_s for sample in (first.start, first.stop - 1))
    what = (
        f"the displacement is constant at {first.level:.5g} {context.quality.unit} from {begin:.6g} to "
        f"{end:.6g} s although {first.direction} is commanded at {level:.3g} "
        f"{command_unit(record, first.direction)}"
    )
    if len(group) > 1:
        what += f", and {len(group) - 1} more times"
    stretches = [(run.start, run.stop) for run in group]
    if saturated:
        advice = "this is the end of the sensor's range: move the sensor, or keep the tests within its range"
        return context.finding(
            "saturated sensor",
            Severity.WARNING,
            what + ", and again at other times",
            advice,
            intervals=stretches,
        )
    advice = "check the sensor and its cable; cut this interval out, or repeat the test"
    return context.finding("stuck sensor", Severity.FAULT, what, advice, intervals=stretches)


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
    constant_runs: list[_ConstantRun] = []
    for direction in context.record.directions:
        strong = _strong(context, direction)
        speed = _speed(displacement, strong[:-1], repeated)
        constant_runs += [
            run
            for run in _commanded_runs(context, direction, strong, stretches, unchanged)
            if run.stop - run.start > shortest and _must_move(run, speed, strong)
        ]
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
    return (
        int(np.count_nonzero(repeated & resting)) / resting_count if resting_count >= FEWEST_AT_REST else 1.0
    )


def _strong(context: RecordContext, direction: str) -> np.ndarray:
    """Return where a command is at least 90 % of its median active value, shape [N]."""
    strong = context.active(direction)
    if strong.any():
        command = np.abs(context.record.command(direction))
        strong &= command >= STRONG * np.median(command[strong])
    return strong


def _commanded_runs(
    context: RecordContext,
    direction: str,
    strong: np.ndarray,
    stretches: list[tuple[int, int]],
    unchanged: float,
) -> list[_ConstantRun]:
    """Return the parts of constant intervals in which the command is strong."""
    log_share = np.log(max(unchanged, 1e-12))
    commanded_runs = []
    for start, stop in stretches:
        level = float(context.record.displacement[start])
        for begin, end in zip(*true_intervals(strong[start : stop + 1]), strict=True):
            noiseless = bool((end - begin) * log_share > np.log(MAX_CHANCE))
            commanded_runs.append(
                _ConstantRun(context, start + int(begin), start + int(end), direction, level, noiseless)
            )
    return commanded_runs


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
