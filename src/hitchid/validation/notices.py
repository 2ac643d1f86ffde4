"""Notices of a validation: warnings on the figures."""

from collections.abc import Sequence

import numpy as np

from hitchid.data.record import DISPLACEMENT, Record
from hitchid.model import Channel, Hitch, Rivals
from hitchid.validation.names import BENCHMARK, GREYBOX, RUNS, model_name
from hitchid.validation.results import Accuracy, CycleResult


def channel_notices(
    direction: str, accuracy: Accuracy, channel: Channel, tests: Sequence[Record]
) -> list[str]:
    """Return the notices of one direction.

    Args:
        direction: lifting or lowering.
        accuracy: of the channel.
        channel: of the model.
        tests: on the model's clock and in its units.
    """
    notices = _accuracy_notices(direction, accuracy) + _out_of_range_notices(direction, channel, tests)
    notices += [
        f"{direction}: the free run uses the mean of '{name}' before motion"
        for name in channel.benchmark.covariates
    ]
    return notices


def baseline_notices(direction: str, rivals: Rivals, tests: Sequence[Record]) -> list[str]:
    """Return the notices of baselines that are not compared.

    Args:
        direction: lifting or lowering.
        rivals: models fitted to the same tests as the channel.
        tests: on the model's clock and in its units.
    """
    notices = [f"{direction}: {notice}" for notice in rivals.notices]
    lacking = [(test.name, name) for test in tests for name in rivals.covariates if name not in test.signals]
    if rivals.baselines and lacking:
        (test, covariate), *_ = lacking
        notices.append(
            f"{direction}: the baselines are not compared: they use '{covariate}', which {test} lacks"
        )
    return notices


def set_by_hand_notices(model: Hitch, direction: str) -> list[str]:
    """Return the notice of the parameters of a direction that were set by hand, if any were."""
    names = model.provenance.set_by_hand.get(direction, {})
    values = ", ".join(
        f"{row.name.replace('_', ' ')} {row.value:.5g} {row.unit}"
        for row in model.parameters[direction]
        if row.name in names
    )
    return (
        [(f"{direction}: {values} set by hand; this direction has no compensators and no bands")]
        if names
        else []
    )


def cycle_notices(model: Hitch, result: CycleResult, factor: float) -> list[str]:
    """Return the notices of mixed cycles.

    Args:
        model: the hitch.
        result: its results.
        factor: from the model's unit of displacement to that of the figures.
    """
    accuracy = result.accuracy
    notices = _limit_notices(model, accuracy, factor)
    if not accuracy.free_run().errs_less(accuracy.free_run(BENCHMARK)):
        notices.append(f"cycles: in free run the grey box is no better than {model_name(BENCHMARK)}")
    return notices


def _accuracy_notices(direction: str, accuracy: Accuracy) -> list[str]:
    uncompensated = accuracy.uncompensated
    left_out = (GREYBOX, BENCHMARK) if uncompensated else (GREYBOX,)
    notices = [f"{direction}: the network correction is not used in simulation"] if uncompensated else []
    for run, label in RUNS.items():
        greybox = accuracy.models[GREYBOX].run(run)
        others = {name: models.run(run) for name, models in accuracy.models.items() if name not in left_out}
        better = [
            model_name(name)
            for name, figures in others.items()
            if figures is not None and greybox is not None and not greybox.errs_less(figures)
        ]
        if better:
            notices.append(f"{direction}: in {label} the grey box is no better than {' and '.join(better)}")
    return notices


def _out_of_range_notices(direction: str, channel: Channel, tests: Sequence[Record]) -> list[str]:
    batch = channel.batch(tests)
    out_of_range = channel.out_of_range(batch, channel.simulate(batch))
    return [
        f"{direction}: in {int(rows.any(axis=1).sum())} of {len(tests)} tests the {name} is outside the "
        "identified range"
        for name, rows in out_of_range.items()
        if rows.any()
    ]


def _limit_notices(model: Hitch, accuracy: Accuracy, factor: float) -> list[str]:
    """Return the number of mixed logs in which the free run reaches a limit that is no end stop."""
    limits = model.limits
    if limits is None:
        return []
    free_runs = accuracy.predictions.models["free_run"]
    limited_runs = sum(bool(np.any(limits.at_soft_limit(run / factor))) for run in free_runs)
    sentence = limits.sentence(model.units[DISPLACEMENT])
    return [f"cycles: {sentence}; {limited_runs} of {len(free_runs)} reach a limit"] if limited_runs else []
