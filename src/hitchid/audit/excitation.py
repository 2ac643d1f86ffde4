"""Whether the tests excite enough: levels, changes, motion, time, and how many there are."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level, runs
from hitchid.audit.look import Look, Survey, command_unit, named
from hitchid.data.record import COMMAND, CYCLE, IDLE, MODES

LEVEL_FRACTION = 0.10
LASTING_PERCENT = (2.0, 98.0)
FEWEST_CHANGES = 4
FEWEST_NOISES = 50.0
LEAST_ACTIVE = 0.10
SHORTEST_S = 3.0
FEWEST_TESTS = 5
ABOVE_DEAD_ZONE = 1.2
SET_OFF_FRACTION = 0.05


def little_motion(look: Look) -> list[AuditFinding]:
    """Find tests whose displacement moves by less than 50 times its noise.

    Noise alone then costs 2 % of fit, as much as good models differ by.
    """
    quality = look.quality
    if look.record.kind == IDLE or not 0 < quality.reach < FEWEST_NOISES * quality.noise:
        return []
    return [
        look.finding(
            "excitation",
            Level.WARNING,
            f"the displacement moves by {quality.reach:.3g} {quality.unit}, "
            f"{quality.reach / quality.noise:.0f} times its noise of {quality.noise:.2g} {quality.unit}",
            "run the test longer or at a higher command",
        )
    ]


def short_or_idle(look: Look) -> list[AuditFinding]:
    """Find tests without any command, active less than 10 % of the time, or shorter than 3 s: notes.

    Rest teaches dead time and drift alone; and 3 s hold only a few dead times and lags of usual valves.
    """
    record, found = look.record, []
    active = int(np.count_nonzero(look.any_active()))
    if record.kind == IDLE or active == 0:
        what = "no command is active; the record is not used"
        return [
            look.finding("excitation", Level.NOTE, what, "leave the log out, or check the columns", signal="")
        ]
    if active < LEAST_ACTIVE * len(record):
        what = f"a command is active in {active / len(record):.1%} of {look.quality.duration_s:.4g} s"
        found.append(look.finding("excitation", Level.NOTE, what, "shorten the rests", signal=""))
    if look.quality.duration_s < SHORTEST_S:
        what = f"the test lasts {look.quality.duration_s:.3g} s"
        advice = f"run tests of at least {SHORTEST_S:g} s, better 10 s"
        found.append(look.finding("excitation", Level.NOTE, what, advice, signal=""))
    return found


def changes(survey: Survey) -> list[AuditFinding]:
    """Find modes with one level of command, or fewer than four changes of it a test.

    One level: the middle 96 % of the active command of all tests lies within 10 % of full scale, which tells
    neither the dead zone nor how the valve's curve runs: a warning. Changes are counted in steps of 10 % of
    full scale; a test with few tells of dead time and lag at these alone: a note. Where there are ramps, they
    have the levels.
    """
    found = []
    for mode in survey.looks[0].record.modes:
        tests = [look for look in survey.looks if look.record.kind in (mode, CYCLE)]
        spans = [(look, *span) for look in tests if (span := _levels(look, mode)) is not None]
        if not spans:
            continue
        low, high = min(span[1] for span in spans), max(span[2] for span in spans)
        if high - low < LEVEL_FRACTION * survey.scales[mode] and not survey.campaign.ramps(mode):
            unit = command_unit(survey.looks[0].record, mode)
            tests = "the one test" if len(spans) == 1 else f"all {len(spans)} tests"
            one = "has" if len(spans) == 1 else "have"
            what = f"{tests} of {mode} {one} one level of command, about {high:.3g} {unit}"
            advice = "run tests at several levels, or a PRBS between two that change from test to test"
            found.append(_about(mode, Level.WARNING, what, advice))
        few = [look.record.name for look, _, _, turns in spans if turns < FEWEST_CHANGES]
        if few:
            what = (
                f"in {len(few)} of {len(spans)} tests the {mode} command changes fewer than "
                f"{FEWEST_CHANGES} times ({named(few)})"
            )
            advice = "change the command more often within a test, as a PRBS does: there lag shows"
            found.append(_about(mode, Level.NOTE, what, advice))
    return found


def _levels(look: Look, mode: str) -> tuple[float, float, int] | None:
    """Return the lowest and highest lasting |c|, and how often it changes; None where it is not active."""
    active = look.active(mode)
    if not active.any():
        return None
    command = np.abs(look.record.command(mode))
    low, high = np.percentile(command[active], LASTING_PERCENT)
    command /= LEVEL_FRACTION * look.scales[mode]
    np.rint(command, out=command)
    return float(low), float(high), int(np.count_nonzero(command[1:] != command[:-1]))


def amount(survey: Survey) -> list[AuditFinding]:
    """Find modes with too few tests to tell a dead zone, an uncertainty, or how good the model is.

    Notes all: no ramp (the dead zone is then estimated from the tests), fewer than five tests (the spread of
    the parameters between tests cannot be told), none held out, never commanded; a warning where in half of
    the tests the command stays below 1.2 times that at which ramps set the piston off.
    """
    campaign, found = survey.campaign, []
    modes = survey.looks[0].record.modes
    mixed = bool(survey.of_kind(CYCLE))
    for mode in modes:
        tests, ramps = survey.of_kind(mode), campaign.ramps(mode)
        strokes = len(tests) + sum(_strokes(look, mode) for look in survey.of_kind(CYCLE))
        if strokes == 0 and not ramps:
            found.append(_about(mode, Level.NOTE, f"{mode} is never commanded", "no model of it is possible"))
            continue
        if not ramps:
            what = f"there is no slow ramp of {mode}: its dead zone is estimated from the tests, less surely"
            found.append(_about(mode, Level.NOTE, what, "add two or three slow ramps from zero"))
        if strokes < FEWEST_TESTS:
            what = f"tests or strokes of {mode}: {strokes}, too few to tell how uncertain the model is"
            found.append(_about(mode, Level.NOTE, what, f"measure at least {FEWEST_TESTS}"))
        if tests and not campaign.held_out(mode) and not (mixed and campaign.held_out(CYCLE)):
            what = f"no test of {mode} is held out: how good the model is cannot be told"
            found.append(
                _about(mode, Level.NOTE, what, "name tests to hold out under [split] in campaign.toml")
            )
        found += _weak(survey, mode)
    return found


def _weak(survey: Survey, mode: str) -> list[AuditFinding]:
    ramps = {record.name for record in survey.campaign.ramps(mode)}
    zones = [_set_off(look, mode) for look in survey.looks if look.record.name in ramps]
    zone, tests = max(zones, default=0.0), survey.of_kind(mode)
    weak = [
        look.record.name
        for look in tests
        if float(np.max(np.abs(look.record.command(mode)))) < ABOVE_DEAD_ZONE * zone
    ]
    if not weak or 2 * len(weak) < len(tests):
        return []
    what = (
        f"in {len(weak)} of {len(tests)} tests the {mode} command stays below "
        f"{ABOVE_DEAD_ZONE:g} times the {zone:.3g} {command_unit(survey.looks[0].record, mode)} at which "
        f"ramps set the piston off ({named(weak)})"
    )
    return [_about(mode, Level.WARNING, what, "run tests at commands well above the dead zone")]


def _set_off(look: Look, mode: str) -> float:
    """Return |c| where a ramp has gone 5 % of its travel, zero where it does not move clearly."""
    quality = look.quality
    if not SET_OFF_FRACTION * quality.reach > quality.sure:
        return 0.0
    moved = np.abs(look.record.displacement - look.record.displacement[0])
    at = int(np.argmax(moved > SET_OFF_FRACTION * quality.reach))
    return float(np.abs(look.record.command(mode)[at]))


def _strokes(look: Look, mode: str) -> int:
    return int(runs(look.active(mode))[0].size)


def _about(mode: str, level: Level, what: str, advice: str) -> AuditFinding:
    check = "excitation" if mode in MODES else "campaign"
    return AuditFinding(check, level, "", COMMAND[mode], (), what, advice)
