"""Checks of the excitation: levels, changes, motion, time, and number of tests."""

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext, command_unit, join_names
from hitchid.audit.finding import AuditFinding, true_intervals
from hitchid.data.record import COMMAND, CYCLE, DIRECTIONS, IDLE

LEVEL_FRACTION = 0.10  # of full scale; smallest difference of two levels of command (chosen)
COMMAND_PERCENTILES = (2.0, 98.0)  # %, of the active command; exclude its transients (chosen)
FEWEST_CHANGES = 4  # changes of the command in a test (chosen)
MIN_NOISE_RATIO = 50.0  # range over noise; at 50 noise costs 2 % of fit
LEAST_ACTIVE = 0.10  # of a test's duration, time with a command (chosen)
SHORTEST_S = 3.0  # s; a few dead times and lags of common valves
FEWEST_TESTS = 5  # tests, for the variance of parameters between tests
ABOVE_DEAD_ZONE = 1.2  # ratio of the command to that at which ramps start motion (chosen)
OUTER = 0.25  # of the range of levels: the weakest or the strongest tests (chosen)
ONSET_FRACTION = 0.05  # of a ramp's travel; defines its onset (chosen)


def little_motion(context: RecordContext) -> list[AuditFinding]:
    """Find tests whose displacement moves by less than 50 times its noise.

    Noise alone then costs 2 % of fit, about the difference between good models.
    """
    quality = context.quality
    if context.record.kind == IDLE or not 0 < quality.peak_to_peak < MIN_NOISE_RATIO * quality.noise:
        return []
    ratio = quality.peak_to_peak / quality.noise
    return [
        context.finding(
            "excitation",
            Severity.WARNING,
            f"the displacement changes by {quality.peak_to_peak:.3g} {quality.unit}, {ratio:.0f} times its "
            f"noise standard deviation of {quality.noise:.2g} {quality.unit}",
            "run the test longer or at a higher command",
        )
    ]


def short_or_idle(context: RecordContext) -> list[AuditFinding]:
    """Find tests without any command, active less than 10 % of the time, or shorter than 3 s: notes.

    Rest contains information on dead time and drift only; 3 s are a few dead times and lags of common valves.
    """
    record, findings = context.record, []
    active = int(np.count_nonzero(context.any_active()))
    if record.kind == IDLE or active == 0:
        what = "no command is active; the record is not used"
        return [
            context.finding(
                "excitation", Severity.NOTE, what, "remove the log, or check its columns", signal=""
            )
        ]
    if active < LEAST_ACTIVE * len(record):
        what = f"a command is active in {active / len(record):.1%} of {context.quality.duration_s:.4g} s"
        findings.append(context.finding("excitation", Severity.NOTE, what, "shorten the rests", signal=""))
    if context.quality.duration_s < SHORTEST_S:
        what = f"the test lasts {context.quality.duration_s:.3g} s"
        advice = f"run tests of at least {SHORTEST_S:g} s, better 10 s"
        findings.append(context.finding("excitation", Severity.NOTE, what, advice, signal=""))
    return findings


def changes(context: CampaignContext) -> list[AuditFinding]:
    """Find directions with one level of command, or tests with fewer than four changes of it.

    One level (the middle 96 % of the active command of all tests lies within 10 % of full scale) determines
    neither dead zone nor valve curve: a warning, unless there are ramps. Changes are counted in steps of 10 %
    of full scale; only they excite dead time and lag: fewer than four are a note.
    """
    findings = []
    for direction in context.tests[0].record.directions:
        tests = [test for test in context.tests if test.record.kind in (direction, CYCLE)]
        spans = [(test, *span) for test in tests if (span := _levels(test, direction)) is not None]
        if not spans:
            continue
        low, high = min(span[1] for span in spans), max(span[2] for span in spans)
        if high - low < LEVEL_FRACTION * context.scales[direction] and not context.campaign.ramps(direction):
            unit = command_unit(context.tests[0].record, direction)
            tests = "the one test" if len(spans) == 1 else f"all {len(spans)} tests"
            verb = "has" if len(spans) == 1 else "have"
            what = f"{tests} of {direction} {verb} one level of command, about {high:.3g} {unit}"
            advice = "run tests at several levels, or PRBS tests with different pairs of levels"
            findings.append(_direction_finding(direction, Severity.WARNING, what, advice))
        few = [test.record.name for test, _, _, turns in spans if turns < FEWEST_CHANGES]
        if few:
            what = (
                f"in {len(few)} of {len(spans)} tests the {direction} command changes fewer than "
                f"{FEWEST_CHANGES} times ({join_names(few)})"
            )
            advice = "change the command more often within a test, as a PRBS does: steps determine the lag"
            findings.append(_direction_finding(direction, Severity.NOTE, what, advice))
    return findings


def _levels(context: RecordContext, direction: str) -> tuple[float, float, int] | None:
    """Return the 2nd and 98th percentile of active |c| and the number of its changes; None without any."""
    active = context.active(direction)
    if not active.any():
        return None
    command = np.abs(context.record.command(direction))
    low, high = np.percentile(command[active], COMMAND_PERCENTILES)
    command /= LEVEL_FRACTION * context.scales[direction]
    np.rint(command, out=command)
    return float(low), float(high), int(np.count_nonzero(command[1:] != command[:-1]))


def one_sided_split(context: CampaignContext) -> list[AuditFinding]:
    """Find directions whose held-out last fifth is of the weakest or strongest tests alone: a note.

    Logs named by their level are held out by it, and the validation says nothing of the others.
    """
    findings, campaign = [], context.campaign
    for direction in context.tests[0].record.directions if campaign.test_patterns is None else ():
        spans = {test.record.name: _levels(test, direction) for test in context.of_kind(direction)}
        highest = {name: span[1] for name, span in spans.items() if span is not None}
        held_out = [highest[test.name] for test in campaign.held_out(direction) if test.name in highest]
        if len(highest) < FEWEST_TESTS or not held_out:
            continue
        names = sorted(highest, key=lambda name: highest[name])
        low, high = highest[names[0]], highest[names[-1]]
        if high - low < LEVEL_FRACTION * context.scales[direction]:
            continue
        shares = [(level - low) / (high - low) for level in held_out]
        if max(shares) > OUTER and min(shares) < 1 - OUTER:
            continue
        unit = command_unit(context.tests[0].record, direction)
        spread = names[FEWEST_TESTS // 2 :: FEWEST_TESTS]
        what = (
            f"the held-out {direction} tests reach {min(held_out):.3g} to {max(held_out):.3g} {unit} only, "
            f"all tests {low:.3g} to {high:.3g} {unit}"
        )
        advice = f"hold out other levels too, under [split] in campaign.toml: {join_names(spread)}"
        findings.append(_direction_finding(direction, Severity.NOTE, what, advice))
    return findings


def too_few_tests(context: CampaignContext) -> list[AuditFinding]:
    """Find directions with too few tests for a dead zone, an uncertainty, or a validation.

    Notes: no ramp (the dead zone is then estimated from the tests), fewer than five tests (the variance of
    the parameters between tests cannot be estimated), none held out, never commanded. A warning: in half of
    the tests the command stays below 1.2 times that at which ramps start motion.
    """
    campaign, findings = context.campaign, []
    directions = context.tests[0].record.directions
    mixed = bool(context.of_kind(CYCLE))
    for direction in directions:
        tests, ramps = context.of_kind(direction), campaign.ramps(direction)
        strokes = len(tests) + sum(_stroke_count(test, direction) for test in context.of_kind(CYCLE))
        if strokes == 0 and not ramps:
            findings.append(
                _direction_finding(
                    direction,
                    Severity.NOTE,
                    f"{direction} is never commanded",
                    "this direction cannot be identified",
                )
            )
            continue
        if not ramps:
            what = f"there is no slow {direction} ramp: the dead zone from tests has a larger error"
            findings.append(
                _direction_finding(direction, Severity.NOTE, what, "add two or three slow ramps from zero")
            )
        if strokes < FEWEST_TESTS:
            what = f"{direction} tests or strokes: {strokes}, too few to estimate the uncertainty"
            findings.append(
                _direction_finding(direction, Severity.NOTE, what, f"measure at least {FEWEST_TESTS}")
            )
        if tests and not campaign.held_out(direction) and not (mixed and campaign.held_out(CYCLE)):
            what = f"no {direction} test is held out: the accuracy of the model cannot be validated"
            findings.append(
                _direction_finding(
                    direction, Severity.NOTE, what, "name tests to hold out under [split] in campaign.toml"
                )
            )
        findings += _weak_commands(context, direction)
    return findings


def _weak_commands(context: CampaignContext, direction: str) -> list[AuditFinding]:
    ramps = {record.name for record in context.campaign.ramps(direction)}
    zones = [_onset_command(test, direction) for test in context.tests if test.record.name in ramps]
    zone, tests = max(zones, default=0.0), context.of_kind(direction)
    weak = [
        test.record.name
        for test in tests
        if float(np.max(np.abs(test.record.command(direction)))) < ABOVE_DEAD_ZONE * zone
    ]
    if not weak or 2 * len(weak) < len(tests):
        return []
    unit = command_unit(context.tests[0].record, direction)
    what = (
        f"in {len(weak)} of {len(tests)} tests the {direction} command stays below {ABOVE_DEAD_ZONE:g} times "
        f"the {zone:.3g} {unit} at which motion starts in ramps ({join_names(weak)})"
    )
    return [
        _direction_finding(
            direction, Severity.WARNING, what, "run tests at commands well above the dead zone"
        )
    ]


def _onset_command(context: RecordContext, direction: str) -> float:
    """Return |c| where a ramp has covered 5 % of its travel; zero if that is within the noise."""
    quality = context.quality
    if not ONSET_FRACTION * quality.peak_to_peak > quality.noise_bound:
        return 0.0
    travel = np.abs(context.record.displacement - context.record.displacement[0])
    onset = int(np.argmax(travel > ONSET_FRACTION * quality.peak_to_peak))
    return float(np.abs(context.record.command(direction)[onset]))


def _stroke_count(context: RecordContext, direction: str) -> int:
    return int(true_intervals(context.active(direction))[0].size)


def _direction_finding(direction: str, severity: Severity, what: str, advice: str) -> AuditFinding:
    check = "excitation" if direction in DIRECTIONS else "campaign"
    return AuditFinding(check, severity, "", COMMAND[direction], (), what, advice)
