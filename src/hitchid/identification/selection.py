"""What stands around a linear benchmark: free run on operating points held out in turn decides."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid._support.metrics import proven_better
from hitchid._support.progress import Heard, Progress, Step, rounds, silent
from hitchid.errors import FitError
from hitchid.estimation import Misfit, Search, free_speeds, polish_some
from hitchid.identification.phase1 import Phase1, assessed, find_parameters
from hitchid.structures import Batch, Form, structure_named
from hitchid.structures.shape import CURVE, SPOOL
from hitchid.uncertainty import KNOWN, DeadZoneError

FOLDS = 4
SAME_LEVEL = 0.01
STEPS = 40
REFITTED = 4
SAMPLES = 2048
RAMPED = (-0.1, 0.1)
FEWEST_APART = 6
# Shares of a dead zone that is tried again with a valve curve; the first decides whether the others are.
SMALLER = (0.5, 0.25, 0.75, 0.0)
NEUTRAL = {
    "opening": 0.4,
    "exponent": 0.5,
    "saturation": 1.0,
    "hysteresis": 0.0,
    "spool_lag": 0.0,
    "dead_time": 0.0,
}
FIRST = ({"natural_frequency": 0.4, "damping_ratio": 0.45}, {"natural_frequency": 0.7, "damping_ratio": 0.7})
CURVES = (
    {"opening": 0.4, "exponent": 0.5, "saturation": 0.4},
    {"opening": 0.25, "exponent": 0.75, "saturation": 0.3},
    {"opening": 0.5, "exponent": 0.6, "saturation": 0.3},
)
WIDTHS = (0.05, 0.1, 0.2)


@dataclass(frozen=True)
class Automatic:
    """In place of a form: the form is chosen, from a plain transfer function up.

    Attributes:
        plain: the form a choice starts from and must beat.
        load: name of the second measured input that may be used; None for the campaign's first, if any.
    """

    plain: Form
    load: str | None = None


@dataclass(frozen=True)
class Candidate:
    """One form that was tried.

    Attributes:
        name: what it has that the ones before have not.
        form: the form.
        rmse: free run over all identification tests, each weighing the same.
        dead_zone: that it was fitted behind, in the command's unit.
        held_out: the same of each test whose operating point was held out in turn, shape [H].
        apart: likewise, apart from a factor on each test's speed, shape [H].
        chosen: whether it is the one that was taken.
    """

    name: str
    form: Form
    rmse: float
    dead_zone: float
    held_out: np.ndarray
    apart: np.ndarray
    chosen: bool = False

    @property
    def held_out_rmse(self) -> float:
        """Free run over operating points held out in turn, each test weighing the same."""
        return float(np.sqrt(np.mean(self.held_out**2)))


def choose_form(
    batch: Batch,
    asked: Automatic,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    opening_known: bool = False,
    revised: bool = False,
    dead_zone: DeadZoneError = KNOWN,
    progress: Progress = silent,
    kept: Checkpoints = NOWHERE,
) -> tuple[Phase1, tuple[Candidate, ...]]:
    """Identify the form that predicts operating points it was not fitted to best in free run.

    Tests are grouped by the level of their command and groups held out in turn, never samples; the lowest and
    the highest stay in, for what lies beyond the tests is not to be asked of a model. Forms nest: each starts
    its least squares from the optimum of the one before, its new curves from a few shapes. A larger form
    takes the place of a smaller one where held-out tests prove it better; a gain that grows along the stroke,
    where six or more of them do apart from a factor on the speed of each test, for a load that nobody
    measures differs from test to test and weighs more than the gain; see `free_speeds`. The one taken is
    identified as any other, by global search and least squares.

    Args:
        batch: identification tests.
        asked: the plain form, and a second input.
        search: of the plain form and of the one chosen.
        seed: every random draw comes from it.
        units: see `identify_benchmark`.
        opening_known: whether the dead zone is where a ramp showed the valve to open: tests at a few levels
            of command say little about flow below the lowest.
        revised: whether the dead zone may be found anew with a valve curve; see `_with_smaller_dead_zone`.
        dead_zone: how well it is known.
        progress: called with what is being done and the fraction that is done.
        kept: where what was found is kept and found again.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """

    def hearing(form: str, start: float) -> Heard:
        return rounds(progress, f"phase 1, {search.name}, {form}", start, 0.3, f"RMSE / {units['x']}")

    hear = hearing("transfer function", 0.0)
    plain = find_parameters(batch, asked.plain, search, seed, heard=hear, kept=kept.part("plain"))
    folds = _folds(batch, alone=asked.load is not None)
    if not folds:
        return assessed(plain, units=units, dead_zone=dead_zone, seed=seed), ()
    coarse = batch.thinned(SAMPLES)
    misfit = Misfit.of(coarse, asked.plain)
    every = range(plain.position.size)
    judged = kept.piece("form", _Judged, lambda: _judged(misfit, every, plain.position, folds))
    tried = [judged.candidate("transfer function", asked.plain, misfit)]
    widest = replace(
        asked.plain,
        structure=structure_named("integrator-second-order"),
        dead_time=True,
        bounds={"opening": RAMPED} if opening_known else {},
        curve=True,
        spool=True,
        position=True,
        load=asked.load,
    )
    misfit = Misfit.of(coarse, widest)
    names = [parameter.name for parameter in widest.parameters]
    positions = np.array([NEUTRAL.get(name, 0.5) for name in names])
    values = misfit.values(positions).copy()
    values[names.index("gain")] = plain.values[0]
    positions = misfit.position(values)
    found: list[np.ndarray] = [np.array([])]
    for name, form in _larger(widest):
        free = [names.index(parameter.name) for parameter in form.parameters]
        misfit = replace(misfit, apart=free_speeds(coarse, form))
        fresh = _starts(form, [] if len(tried) == 1 else list(tried[-1].form.parameters))
        starts = [_with(positions, names, start) for start in ({}, *fresh)]
        try:
            judged = kept.piece(f"form {name}", _Judged, partial(_fitted, misfit, free, starts, folds))
        except FitError:
            continue  # a larger form that cannot be fitted is none to choose
        positions = judged.positions
        if form.curve and not tried[-1].form.curve and revised:
            misfit, judged = _with_smaller_dead_zone(misfit, judged, free, folds, kept)
            positions = judged.positions
        tried.append(judged.candidate(name, form, misfit))
        told = {f"RMSE on levels held out / {units['x']}": tried[-1].held_out_rmse}
        progress(Step("phase 1, structures", 0.3 + 0.05 * len(tried), name, told))
        found.append(misfit.values(positions)[free])
    chosen = 0
    for number, candidate in enumerate(tried):
        before = tried[chosen]
        proven = (
            candidate.apart.size >= FEWEST_APART and proven_better(candidate.apart, before.apart)
            if free_speeds(coarse, candidate.form)
            else proven_better(candidate.held_out, before.held_out)
        )
        chosen = number if proven else chosen
    tried[chosen] = replace(tried[chosen], chosen=True)
    if chosen == 0:
        return assessed(plain, units=units, dead_zone=dead_zone, seed=seed), tuple(tried)
    hear = hearing(tried[chosen].name, 0.7)
    taken = tried[chosen]
    behind = batch if taken.dead_zone == tried[0].dead_zone else batch.with_dead_zone(taken.dead_zone)
    fit = find_parameters(
        behind, taken.form, search, seed, start=found[chosen], heard=hear, kept=kept.part("chosen")
    )
    return assessed(fit, units=units, dead_zone=dead_zone, seed=seed), tuple(tried)


@dataclass(frozen=True)
class _Judged:
    """A form's best positions, shape [D], and what `Candidate` tells of it."""

    positions: np.ndarray
    rmse: float
    held_out: np.ndarray
    apart: np.ndarray

    def candidate(self, name: str, form: Form, misfit: Misfit) -> Candidate:
        dead_zone = float(misfit.batch.dead_zone[0])
        return Candidate(name, form, self.rmse, dead_zone, self.held_out, self.apart)


def _larger(widest: Form) -> list[tuple[str, Form]]:
    """Return names and forms from a dead time up to everything."""
    late = replace(widest, bounds={}, curve=False, spool=False, position=False, load=None)
    curved = replace(late, bounds=widest.bounds, curve=True)
    played = replace(curved, spool=True)
    sloped = replace(played, slope=True)
    placed = replace(played, position=True)
    forms = [
        ("second order, dead time", late),
        ("with valve curve", curved),
        ("with lag and hysteresis of the spool", played),
        ("with gain growing along the stroke", sloped),
        ("with any gain along the stroke", placed),
        (f"with {widest.load}", widest),
    ]
    return forms[:1] + [larger for before, larger in pairwise(forms) if larger[1] != before[1]]


def _starts(form: Form, before: Sequence) -> Sequence[Mapping[str, float]]:
    """Return where to start what a form has and the one before it has not: name to place in the cube."""
    names = {parameter.name for parameter in before}
    if not names:
        return [{**first, "dead_time": 0.6} for first in FIRST]
    if form.curve and CURVE[0].name not in names:
        return CURVES
    if form.spool and SPOOL[0].name not in names:
        return [
            {"hysteresis": width, "spool_lag": 0.5, **curve} for width in WIDTHS for curve in ({}, CURVES[0])
        ]
    return ({},)


def _with(positions: np.ndarray, names: Sequence[str], start: Mapping[str, float]) -> np.ndarray:
    moved = positions.copy()
    for name, place in start.items():
        moved[names.index(name)] = place
    return moved


def _fitted(
    misfit: Misfit, free: Sequence[int], starts: Sequence[np.ndarray], folds: Sequence[np.ndarray]
) -> _Judged:
    """Fit the free parameters from several starts, and judge the best."""
    best = polish_some(misfit, free, starts, STEPS)
    positions = starts[0].copy()
    positions[list(free)] = best.position
    return _judged(misfit, free, positions, folds)


def _with_smaller_dead_zone(
    misfit: Misfit, judged: _Judged, free: Sequence[int], folds: Sequence[np.ndarray], kept: Checkpoints
) -> tuple[Misfit, _Judged]:
    """Return a form with a valve curve behind a smaller dead zone where held-out tests prove that better.

    A dead zone found from tests is that of a valve that is linear beyond it: one that opens slowly seems to
    open late. Its curve makes up for a dead zone that is too small, not for one that is too large: where half
    of it is no better, nothing else is tried.
    """
    names = [parameter.name for parameter in misfit.form.parameters]
    found, best = float(misfit.batch.dead_zone[0]), (misfit, judged)
    for share in SMALLER:
        other = Misfit.of(misfit.batch.with_dead_zone(share * found), misfit.form)
        start = other.position(misfit.values(judged.positions))
        starts = [start, *(_with(start, names, curve) for curve in CURVES)]
        try:
            fitted = kept.piece(
                f"form behind {share:g}", _Judged, partial(_fitted, other, free, starts, folds)
            )
        except FitError:
            continue
        if proven_better(fitted.held_out, best[1].held_out):
            best = other, fitted
        elif best[0] is misfit:
            break
    return best


def _judged(
    misfit: Misfit, free: Sequence[int], positions: np.ndarray, folds: Sequence[np.ndarray]
) -> _Judged:
    """Judge a form by tests held out in turn.

    The others refit it from its best position by three damped steps: those reach what the tests determine.
    What they hardly determine keeps the value that all tests gave it, where a full descent would take it
    anywhere; so the figure is a little too good for large forms.
    """
    pooled, apart = misfit.pooled(), replace(misfit, apart=True)
    whole = pooled.error(positions)
    held_out, held_apart = [], []
    for held in folds:
        kept = _over(misfit, ~held)
        moved = positions.copy()
        moved[list(free)] = polish_some(kept, free, [positions], REFITTED).position
        held_out += list(pooled.by_test(moved)[held])
        held_apart += list(apart.by_test(moved)[held])
    return _Judged(positions, whole, np.array(held_out), np.array(held_apart))


def _over(misfit: Misfit, tests: np.ndarray) -> Misfit:
    """Return the misfit over some of its tests; shapes stay, so that no program is compiled anew."""
    batch = misfit.batch.counting(jnp.asarray(np.broadcast_to(tests[:, None], misfit.batch.counted.shape)))
    return misfit.over(batch)


def _folds(batch: Batch, *, alone: bool) -> list[np.ndarray]:
    """Return which tests are held out together, boolean arrays of shape [T].

    Every fourth operating point between the lowest and the highest level, so that a fold's neighbours stay
    in. Tests of one level are one operating point; with a second input every test is one of its own.
    """
    command, counted = np.abs(np.asarray(batch.command)), np.asarray(batch.counted)
    active = counted & (command > 0)
    levels = np.array([row[on].mean() if on.any() else 0.0 for row, on in zip(command, active, strict=True)])
    order = np.argsort(levels)
    apart = alone | (np.diff(levels[order]) > SAME_LEVEL * float(np.ptp(levels)))
    group = np.concatenate([[0], np.cumsum(apart)])
    inside = (group > 0) & (group < group[-1])
    number = np.full(levels.size, -1)
    number[order] = np.where(inside, (group - 1) % FOLDS, -1)
    return [number == each for each in range(min(FOLDS, int(group[-1]) - 1))]
