"""Whether tests of one mode repeat: their speed, their start, and the command at which ramps set off."""

import numpy as np
from scipy.special import stdtr

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look, Survey, command_unit, named, travel
from hitchid.data.record import COMMAND, DISPLACEMENT, MODES, RAMP
from hitchid.data.test_kinds import ramp_mode

COMPARABLE = 0.25
FEWEST_TESTS = 5
SURE = 0.005
WORTH_DRIFT = 0.05
START_FRACTION = 0.05
ONSET_FRACTION = 0.10
SAME_RATE = 0.10
TOLD_APART = 0.1
ROUNDING = 1e-12


def drift(survey: Survey) -> list[AuditFinding]:
    """Find speeds that grow or fall with the order of the tests.

    Of tests whose mean command lies within ±25 % of the median (five at least), travel = K (∫|c| dt − d T) is
    fitted for gain K and dead zone d; the logarithm of each test's own gain is then regressed on order and
    mean command, which takes along what a bent valve curve does; commands in rising order (nine tenths of
    the order's spread explained by them) tell nothing. A trend counts by its t-test at 0.5 % and
    if it changes the speed by 5 % from the first test to the last: less is within what oil does in an hour.
    """
    found = []
    for mode in MODES:
        looks, travels, areas, times = _comparable(survey, mode)
        if len(looks) < FEWEST_TESTS:
            continue
        change, odds = _trend(travels, areas, times)
        if not (odds < SURE and abs(change) > WORTH_DRIFT):
            continue
        what = (
            f"for the same command, {mode} is {abs(change):.0%} {'faster' if change > 0 else 'slower'} "
            f"in the last test than in the first, over {len(looks)} tests "
            f"({named([look.record.name for look in looks])})"
        )
        advice = "warm the oil before measuring, or log its temperature; hold out tests from all of the day"
        found.append(AuditFinding("drift", Level.WARNING, "", DISPLACEMENT, (), what, advice))
    return found


def _comparable(survey: Survey, mode: str) -> tuple[list[Look], np.ndarray, np.ndarray, np.ndarray]:
    """Return tests of like command, with travel, ∫|c| dt and active time of each."""
    looks = survey.of_kind(mode)
    rows = []
    for look in looks:
        active = look.active(mode)
        time = int(np.count_nonzero(active)) * look.record.step_s
        area = float(np.sum(np.abs(look.record.command(mode)), where=active)) * look.record.step_s
        rows.append((abs(travel(look, mode)), area, time))
    table = np.array(rows).reshape(-1, 3)
    with np.errstate(all="ignore"):
        means = table[:, 1] / table[:, 2]
    usable = np.isfinite(means) & (means > 0) & (table[:, 0] > 0)
    if not usable.any():
        return [], *table[:0].T
    near = usable & (np.abs(means / np.median(means[usable]) - 1) <= COMPARABLE)
    kept = [look for look, near_it in zip(looks, near, strict=True) if near_it]
    return kept, *table[near].T


def _trend(travels: np.ndarray, areas: np.ndarray, times: np.ndarray) -> tuple[float, float]:
    """Return the relative change of the gain from the first test to the last, and the odds of chance."""
    nothing = (0.0, 1.0)
    means, speeds = areas / times, travels / times
    varied = bool(np.ptp(means) > 0.01 * means.mean())
    slope, offset = np.polyfit(means, speeds, 1) if varied else (0.0, 0.0)
    # A dead zone above nine tenths of the smallest mean would make gains of rounding.
    zone = min(max(0.0, -offset / slope), 0.9 * means.min()) if slope > 0 else 0.0
    gains = np.log(speeds / (means - zone))
    order = np.arange(gains.size) / (gains.size - 1)
    others = np.stack([np.ones(gains.size), *([means / means.mean()] if varied else [])], axis=1)
    free = gains.size - 1 - others.shape[1] - (zone > 0)
    if free < 1 or not np.all(np.isfinite(gains)):
        return nothing
    own, left = _without(order, others), _without(gains, others)
    # Commands that rise with the order leave no part of the order to tell a drift by.
    if float(own @ own) < TOLD_APART * float(np.sum((order - order.mean()) ** 2)):
        return nothing
    slope = float(own @ left / (own @ own))
    rest = left - slope * own
    error = float(np.sqrt(rest @ rest / free / (own @ own)))
    if error <= ROUNDING:
        return float(np.expm1(slope)), 0.0 if abs(slope) > 1e3 * ROUNDING else 1.0
    return float(np.expm1(slope)), float(2 * stdtr(free, -abs(slope) / error))


def _without(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return what of values no linear combination of others explains, shape [T]."""
    best, *_ = np.linalg.lstsq(others, values, rcond=None)
    return values - others @ best


def start_positions(survey: Survey) -> list[AuditFinding]:
    """Find modes whose tests start at places more than 5 % of the campaign's range apart.

    A linkage moves the load at another leverage there, so that speeds differ: a note.
    """
    found = []
    for mode in MODES:
        starts = [float(look.record.displacement[0]) for look in survey.of_kind(mode)]
        if len(starts) < 2 or not max(starts) - min(starts) > START_FRACTION * survey.reach:
            continue
        unit = survey.looks[0].quality.unit
        what = (
            f"the {len(starts)} tests of {mode} start between {min(starts):.4g} and {max(starts):.4g} {unit}"
        )
        advice = "good for a model of the whole stroke; start repeats that are to be compared at one place"
        found.append(AuditFinding("start position", Level.NOTE, "", DISPLACEMENT, (), what, advice))
    return found


def ramp_onsets(survey: Survey) -> list[AuditFinding]:
    """Find repeated ramps that set the piston off at different commands.

    Of ramps that rise within 10 % equally fast, the command at which each has travelled half of what the
    shortest travels; a spread of more than 10 % of it is a warning: no one dead zone holds for all.
    """
    found = []
    for mode in MODES:
        ramps = _ramps(survey, mode)
        if len(ramps) < 2:
            continue
        tops = [float(np.max(np.abs(look.record.command(mode)))) for look in ramps]
        rates = [top / look.quality.duration_s for top, look in zip(tops, ramps, strict=True)]
        like = [
            look
            for look, rate in zip(ramps, rates, strict=True)
            if abs(rate / np.median(rates) - 1) <= SAME_RATE
        ]
        shortest = min((look.quality.reach for look in like), default=0.0)
        if len(like) < 2 or not shortest > 2 * max(look.quality.sure for look in like):
            continue
        onsets = [_onset(look, mode, shortest / 2) for look in like]
        middle = float(np.median(onsets))
        if not max(onsets) - min(onsets) > ONSET_FRACTION * middle:
            continue
        unit = command_unit(survey.looks[0].record, mode)
        what = (
            f"{len(like)} equal ramps of {mode} set the piston off between {min(onsets):.3g} and "
            f"{max(onsets):.3g} {unit} ({named([look.record.name for look in like])})"
        )
        advice = "repeat the ramps with warm oil and the same load; the dead zone is their mean"
        found.append(AuditFinding("dead zone", Level.WARNING, "", COMMAND[mode], (), what, advice))
    return found


def _ramps(survey: Survey, mode: str) -> list[Look]:
    return [look for look in survey.of_kind(RAMP) if ramp_mode(look.record) == mode]


def _onset(look: Look, mode: str, moved: float) -> float:
    """Return |c|, the mean of eleven samples, where the displacement has gone so far from its start."""
    away = np.abs(look.record.displacement - look.record.displacement[0]) >= moved
    at = int(np.argmax(away))
    return float(np.mean(np.abs(look.record.command(mode)[max(0, at - 5) : at + 6])))
