"""The trace of an identification as JSON can hold it."""

import math
from dataclasses import asdict

import numpy as np

from hitchid.identification.direction import ChannelTrace


def describe_channel(trace: ChannelTrace) -> dict:
    """Return how one direction was identified: dead zone, parameters, search, losses, notices.

    What is not finite (the standard error of an undetermined parameter) is null.
    """
    dead_zone, phase1, phase2, gate = trace.dead_zone, trace.phase1, trace.phase2, trace.gate
    found = phase1.fit.found
    return {
        "dead_zone": {
            "value": dead_zone.value,
            "spread": dead_zone.spread,
            "count": dead_zone.count,
            "origin": dead_zone.origin,
        },
        "characteristics": None if trace.characteristics is None else asdict(trace.characteristics),
        "phase1": {
            "uncertainty": asdict(phase1.known),
            "rmse": phase1.rmse,
            "rmse_before_polish": phase1.search_rmse,
            "evaluations": found.evaluations,
            "failures": found.failures,
            "reason": found.reason,
            "fitness": [_finite(value) for value in found.fitness_trace],
            "values": np.column_stack(
                [
                    estimate.at(column)
                    for estimate, column in zip(phase1.estimates, found.best_trace.T, strict=True)
                ]
            ).tolist(),
        },
        "phase2": None
        if phase2 is None
        else {
            "training_loss": [_finite(value) for value in phase2.training],
            "validation_loss": [_finite(value) for value in phase2.validation],
            "best_epoch": phase2.best_epoch,
            "reason": phase2.ending.value,
        },
        "gate": None
        if gate is None
        else {
            "open": gate.open,
            "benchmark": gate.benchmark.tolist(),
            "compensated": gate.compensated.tolist(),
            "best_epochs": list(gate.best_epochs),
            "training_loss": [[_finite(value) for value in row] for row in gate.training],
            "validation_loss": [[_finite(value) for value in row] for row in gate.validation],
        },
        "candidates": [
            {
                "name": candidate.name,
                "parameters": len(candidate.form.parameters),
                "rmse": candidate.rmse,
                "held_out_rmse": candidate.held_out_rmse,
                "held_out_tests": candidate.held_out.tolist(),
                "chosen": candidate.chosen,
            }
            for candidate in trace.candidates
        ],
        "notices": list(trace.notices),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
