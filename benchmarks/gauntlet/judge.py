"""One campaign of the zoo from its logs to a verdict."""

import tempfile
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

import hitchid
from hitchid.data.record import MODES
from hitchid.model import Hitch

from .outcome import MODEL, REFUSED, Outcome, attempted
from .zoo import Truth, draw

PHYSICS = {"training": None, "comparison": None}
GROSS = 2.0
STEPPED = 50
# A refusal names what came and what was required, or what to change or to measure.
ADVICE = ("required", "measure", "name ", "give ", "use ", "must", "check", "needs")
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
    with tempfile.TemporaryDirectory() as place:
        target = Path(folder) / str(seed) if folder else Path(place) / str(seed)
        with outcome.timed("draw"):
            truth = draw(seed, target)
        outcome.words = truth.words
        attempted(outcome, lambda told: _run(told, truth, PHYSICS if physics else {}, Path(place)))
        outcome.message = outcome.message.replace(f"{target}/", "")
    if outcome.result == REFUSED:
        outcome.failures += _unjustified(outcome, truth)
    elif outcome.result == MODEL and truth.unusable:
        outcome.verdicts.append(f"a model, although {truth.unusable}")
    return outcome


def _run(outcome: Outcome, truth: Truth, settings: dict[str, Any], place: Path) -> None:
    with outcome.timed("read"):
        campaign, fresh = hitchid.read(truth.logs), hitchid.read(truth.fresh)
    with outcome.timed("identify"):
        found = hitchid.identify(campaign, **settings)
    model, _ = used(outcome, found, fresh, place)
    for mode in model.channels:
        _compare(outcome, model, mode, truth)


def used(outcome: Outcome, found: Any, fresh: hitchid.Campaign, place: Path) -> tuple[Hitch, dict]:
    """Save, load, validate, simulate and step an identified model; return what was loaded, and its metrics.

    Args:
        outcome: gets times, figures, and what should not be.
        found: what `identify` returned.
        fresh: tests the identification has not seen.
        place: an existing folder.
    """
    with outcome.timed("save and load"):
        found.save(place / "model")
        model = hitchid.load(place / "model")
    with outcome.timed("validate"):
        metrics = hitchid.validate(model, fresh).metrics
    for name, channel in {**metrics["channels"], "cycles": metrics["cycles"]}.items():
        if "greybox" in channel:
            run = channel["greybox"]["free_run"]
            outcome.figures |= {f"{name}: {key}": run[key] for key in ("rmse", "r2") if run[key] is not None}
            if run["rmse"] is None:
                outcome.failures.append(f"{name}: the free run diverges on unseen tests")
    with outcome.timed("simulate and step"):
        # A campaign of one test identifies one direction; fresh tests have both.
        known = [record for record in fresh.records if _has_channels(model, record)]
        record = max(known, key=lambda record: float(np.ptp(record.displacement)))
        if not np.all(np.isfinite(model.simulate(record))):
            outcome.failures.append("simulate: a displacement is not finite")
        if not np.all(np.isfinite(_stepped(model, record))):
            outcome.failures.append("step: a displacement is not finite")
    return model, metrics


def _has_channels(model: Hitch, record: hitchid.Record) -> bool:
    """Tell whether a model has a channel for every command that a record excites."""
    return all(mode in model.channels or not np.any(record.command(mode)) for mode in record.modes)


def _stepped(model: Hitch, record: hitchid.Record) -> np.ndarray:
    """Return what a model says sample by sample, measured displacement in every second."""
    own = model.adopt(record)
    state = model.initial(float(own.displacement[0]))
    said = []
    for number in range(min(STEPPED, len(own))):
        commands = [own.command(mode)[number] if mode in own.modes else 0.0 for mode in MODES]
        measured = float(own.displacement[number]) if number % 2 else None
        state, displacement = model.step(state, commands, measured)
        said.append(float(displacement))
    return np.array(said)


def _unjustified(outcome: Outcome, truth: Truth) -> list[str]:
    """Return what is wrong with a refusal."""
    if not truth.unusable:
        return [f"{outcome.stage}: refused, although the logs are good: {outcome.message}"]
    if not any(word in outcome.message.lower() for word in ADVICE):
        return [f"{outcome.stage}: refused without saying what to change or to measure: {outcome.message}"]
    return []


def _compare(outcome: Outcome, model: Hitch, mode: str, truth: Truth) -> None:
    """Count the determined parameters of a direction that hold the truth, and list those far from it."""
    known = model.uncertainty.get(mode)
    if known is None:
        return
    names = {estimate.name for estimate in known.benchmark.parameters}
    expected = _comparable(truth.values.get(mode, {}), names, truth.slack_s)
    for estimate in known.benchmark.parameters:
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
        outcome.held += outside == 0
        if outside:
            kind = "gross miss" if outside > GROSS * (upper - lower) else "miss"
            channel, zone = model.channels[mode], truth.values[mode]["dead_zone"]
            outcome.verdicts.append(
                f"{kind}: {mode} {estimate.name}: {value:.4g}, determined as {lower:.4g} to {upper:.4g}; the "
                f"form has {', '.join(sorted(names))}; dead zone {zone:.4g}, found {channel.dead_zone:.4g}"
            )


def _comparable(values: dict[str, float], names: set[str], slack_s: float) -> dict[str, float]:
    """Return the true values that mean the same in the form that was taken.

    A lag is another quantity where the form has a lag that the plant has not, or the other way round; the
    shape of a second-order lag has no slack to compare by where the clock is uneven.
    """
    parts = {name for name in values if name in (*LAGS, "dead_time")}
    same = parts == names & {*LAGS, "dead_time", "spool_lag"}
    comparable = {name: value for name, value in values.items() if name in ("gain", "exponent") or same}
    if slack_s:
        comparable = {n: v for n, v in comparable.items() if n not in ("natural_frequency", "damping_ratio")}
    return comparable
