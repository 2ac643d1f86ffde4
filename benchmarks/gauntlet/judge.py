"""One campaign of the zoo from its logs to a verdict."""

import tempfile
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

import hitchid
from hitchid.logs.record import DIRECTIONS
from hitchid.model import Hitch

from .outcome import MODEL, REFUSED, Outcome, run_guarded
from .rivals import WORSE, best_rival, difference
from .zoo import Truth, draw

PHYSICS = {"training": None, "rivals": None}
GROSS_MISS_WIDTHS = 2.0
MAX_STEPS = 50
# A refusal names what it got and what was expected, or what to change or to measure.
ADVICE = ("required", "expected", "choose ", "measure", "name ", "give ", "use ", "must", "check", "needs")
LAGS = ("time_constant", "natural_frequency", "damping_ratio")
TIMES = ("time_constant", "dead_time")


def judge(seed: int, *, physics: bool, folder: str | None = None) -> Outcome:
    """Draw a campaign, identify from it, use the model, and compare with the truth.

    Args:
        seed: of the campaign.
        physics: whether without training and without comparison of searches.
        folder: where its logs stay; None removes them.
    """
    outcome = Outcome(f"zoo {seed}, {'physics' if physics else 'default'}")
    with tempfile.TemporaryDirectory() as temporary_folder:
        target = Path(folder) / str(seed) if folder else Path(temporary_folder) / str(seed)
        with outcome.timed("draw"):
            truth = draw(seed, target)
        outcome.description = truth.description
        run_guarded(
            outcome,
            lambda run_outcome: _run(run_outcome, truth, PHYSICS if physics else {}, Path(temporary_folder)),
        )
        outcome.message = outcome.message.replace(f"{target}/", "")
    if outcome.result == REFUSED:
        outcome.failures += _unjustified(outcome, truth)
    elif outcome.result == MODEL and truth.unusable:
        outcome.verdicts.append(f"a model, although {truth.unusable}")
    return outcome


def _run(outcome: Outcome, truth: Truth, settings: dict[str, Any], folder: Path) -> None:
    with outcome.timed("read"):
        campaign, unseen = hitchid.read(truth.logs), hitchid.read(truth.unseen)
    with outcome.timed("identify"):
        identification = hitchid.identify(campaign, **settings)
    if not unseen.without(identification.model.provenance.seen).records:
        # Without noise, a test of one level is the same each time it is drawn.
        outcome.verdicts.append("not validated: the fresh tests equal those of the identification")
        return
    model, _ = exercise_model(outcome, identification, unseen, folder)
    for direction in model.channels:
        _compare(outcome, model, direction, truth)


def exercise_model(
    outcome: Outcome, identification: Any, unseen: hitchid.Campaign, folder: Path
) -> tuple[Hitch, dict]:
    """Save, load, validate, simulate and step an identified model; return what was loaded, and its metrics.

    Args:
        outcome: gets times, figures, and what should not be.
        identification: what `identify` returned.
        unseen: tests the identification has not seen.
        folder: an existing folder.
    """
    with outcome.timed("save and load"):
        identification.save(folder / "model")
        model = hitchid.load(folder / "model")
    with outcome.timed("validate"):
        result = hitchid.validate(model, unseen)
    metrics = result.metrics
    for name, accuracy in result.accuracy.items():
        rival = best_rival(accuracy)
        if rival is not None:
            verdict = difference(accuracy, rival)
            outcome.verdicts.append(f"{name}: free run beside the best rival, {rival}: {verdict}")
            outcome.figures[f"{name}: significantly worse than the best rival"] = float(verdict == WORSE)
    for name, channel in {**metrics["channels"], "cycles": metrics["cycles"]}.items():
        if "greybox" in channel:
            run = channel["greybox"]["free_run"]
            outcome.figures |= {f"{name}: {key}": run[key] for key in ("rmse", "r2") if run[key] is not None}
            if run["rmse"] is None:
                outcome.failures.append(f"{name}: the free run diverges on unseen tests")
    with outcome.timed("simulate and step"):
        record = _widest_usable(model, unseen)
        if not np.all(np.isfinite(model.simulate(record).displacement)):
            outcome.failures.append("simulate: a displacement is not finite")
        if not np.all(np.isfinite(_step_predictions(model, record))):
            outcome.failures.append("step: a displacement is not finite")
    return model, metrics


def _widest_usable(model: Hitch, unseen: hitchid.Campaign) -> hitchid.Record:
    """Return the test of most travel, or the stroke where every test excites a direction without a channel.

    A campaign of one test may identify one direction only, where fresh tests have both.
    """
    strokes = unseen.segmented(model.segmentation_dead_zones(unseen.units)).records
    whole = [record for record in unseen.records if _has_channels(model, record)]
    usable_records = whole or [record for record in strokes if _has_channels(model, record)]
    return max(usable_records, key=lambda record: float(np.ptp(record.displacement)))


def _has_channels(model: Hitch, record: hitchid.Record) -> bool:
    """Tell whether a model has a channel for every command that a record excites."""
    return all(
        direction in model.channels or not np.any(record.command(direction))
        for direction in record.directions
    )


def _step_predictions(model: Hitch, record: hitchid.Record) -> np.ndarray:
    """Return what a model says sample by sample, measured displacement in every second."""
    converted = model.to_model_units(record)
    state = model.init_state(float(converted.displacement[0]))
    predictions = []
    for number in range(min(MAX_STEPS, len(converted))):
        commands = [
            converted.command(direction)[number] if direction in converted.directions else 0.0
            for direction in DIRECTIONS
        ]
        measured = float(converted.displacement[number]) if number % 2 else None
        state, displacement = model.step(state, commands, measured)
        predictions.append(float(displacement))
    return np.array(predictions)


def _unjustified(outcome: Outcome, truth: Truth) -> list[str]:
    """Return what is wrong with a refusal."""
    if not truth.unusable:
        return [f"{outcome.stage}: refused, although the logs are good: {outcome.message}"]
    if not any(word in outcome.message.lower() for word in ADVICE):
        return [f"{outcome.stage}: refused without saying what to change or to measure: {outcome.message}"]
    return []


def _compare(outcome: Outcome, model: Hitch, direction: str, truth: Truth) -> None:
    """Count the determined parameters of a direction that hold the truth, and list those far from it."""
    uncertainty = model.uncertainty.get(direction)
    if uncertainty is None:
        return
    names = {estimate.name for estimate in uncertainty.benchmark.parameters}
    expected = _comparable(truth.values.get(direction, {}), names, truth.slack_s)
    for estimate in uncertainty.benchmark.parameters:
        if estimate.name not in expected or not estimate.determined:
            continue
        slack = truth.slack_s if estimate.name in TIMES else 0.0
        lower, upper = (
            -inf if estimate.interval[0] is None else estimate.interval[0] - slack,
            inf if estimate.interval[1] is None else estimate.interval[1] + slack,
        )
        value = expected[estimate.name]
        outside = max(lower - value, value - upper, 0.0)
        outcome.determined += 1
        outcome.covered += outside == 0
        if outside:
            kind = "gross miss" if outside > GROSS_MISS_WIDTHS * (upper - lower) else "miss"
            channel, zone = model.channels[direction], truth.values[direction]["dead_zone"]
            outcome.verdicts.append(
                f"{kind}: {direction} {estimate.name}: {value:.4g}, determined as {lower:.4g} to "
                f"{upper:.4g}; the "
                f"form has {', '.join(sorted(names))}; dead zone {zone:.4g}, found {channel.dead_zone:.4g}"
            )


def _comparable(values: dict[str, float], names: set[str], slack_s: float) -> dict[str, float]:
    """Return the true values that mean the same in the form that was taken.

    A lag is another quantity where the form has a lag that the plant has not, or the other way round; the
    shape of a second-order lag has no slack to compare by where the clock is uneven.
    """
    dynamics_names = {name for name in values if name in (*LAGS, "dead_time")}
    same = dynamics_names == names & {*LAGS, "dead_time", "spool_lag"}
    comparable = {name: value for name, value in values.items() if name in ("gain", "exponent") or same}
    if slack_s:
        comparable = {n: v for n, v in comparable.items() if n not in ("natural_frequency", "damping_ratio")}
    return comparable
