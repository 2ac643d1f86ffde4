"""The trace of an identification as JSON values."""

import math
from dataclasses import asdict

import numpy as np

from hitchid._support.precision import double_precision
from hitchid.identification.channel_trace import ChannelTrace


@double_precision
def describe_channel(trace: ChannelTrace) -> dict:
    """Return how one direction was identified: dead zone, parameters, search, losses, notices.

    What is not finite (the standard error of an undetermined parameter) is null.
    """
    dead_zone, phase1, phase2, holdout_test = trace.dead_zone, trace.phase1, trace.phase2, trace.holdout_test
    search_result, objective = phase1.fit.search_result, phase1.fit.searched
    # A smaller form may have been searched: of its parameters those that the model has.
    names = {estimate.name for estimate in phase1.parameter_estimates}
    searched = {
        parameter.name: column
        for parameter, column in zip(
            objective.spec.parameters, objective.values(search_result.best_trace).T, strict=True
        )
        if parameter.name in names
    }
    return {
        "dead_zone": {
            "value": dead_zone.value,
            "spread": dead_zone.spread,
            "count": dead_zone.count,
            "origin": dead_zone.origin,
        },
        "characteristics": None if trace.characteristics is None else asdict(trace.characteristics),
        "phase1": {
            "uncertainty": asdict(phase1.assessment),
            "rmse": phase1.rmse,
            "rmse_before_polish": phase1.search_rmse,
            "evaluations": search_result.evaluations,
            "failures": search_result.failures,
            "reason": search_result.reason,
            "fitness": [_finite(value) for value in search_result.fitness_trace],
            "searched": list(searched),
            "values": np.column_stack(list(searched.values())).tolist(),
        },
        "phase2": None
        if phase2 is None
        else {
            "training_loss": [_finite(value) for value in phase2.training],
            "validation_loss": [_finite(value) for value in phase2.validation],
            "best_epoch": phase2.best_epoch,
            "reason": phase2.stop_reason.value,
        },
        "gate": None
        if holdout_test is None
        else {
            "open": holdout_test.accepted,
            "benchmark": holdout_test.benchmark.tolist(),
            "compensated": holdout_test.compensated.tolist(),
        },
        "candidates": [
            {
                "name": candidate.name,
                "parameters": len(candidate.spec.parameters),
                "rmse": candidate.rmse,
                "held_out_rmse": candidate.held_out_rmse,
                "held_out_tests": candidate.held_out.tolist(),
                "held_out_rmse_per_test_gain": candidate.held_out_rmse_per_test_gain,
                "chosen": candidate.chosen,
            }
            for candidate in trace.candidates
        ],
        "choice_held_out_rmse": trace.choice_held_out_rmse,
        "notices": list(trace.notices),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
