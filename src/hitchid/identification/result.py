"""Result of an identification: the model, and how each direction was identified."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid._support.screen import first_notes
from hitchid._support.tables import Summarised, Table
from hitchid.estimation.training import TrainingHistory
from hitchid.identification.candidates import Candidate, held_out_errors_of_choice
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.phase1 import Phase1
from hitchid.identification.speed_training import HoldoutTest
from hitchid.logs.record import DISPLACEMENT
from hitchid.model import Characteristics, Hitch, Rivals, Uncertainty, save
from hitchid.model.parameters import hitch_summary

MAX_NOTICES = 3  # that are shown; chosen


@short_repr
@dataclass(frozen=True)
class ChannelTrace:
    """How one direction was identified.

    Attributes:
        dead_zone: the dead zone and its origin.
        phase1: benchmark, parameters, search.
        phase2: losses of the training of the compensator for predictions; None where none was trained.
        holdout_test: test of the compensator for free run on tests held out; None where none was trained.
        notices: remarks on the data and on choices made automatically.
        candidates: the candidates that were compared by an automatic choice of structure.
        seconds: name of each fit to its duration, s.
        uncertainty: of the channel.
        rivals: fitted to the same tests.
        characteristics: speed map, dead zone, delay and response time; None where there are none.
    """

    dead_zone: DeadZone
    phase1: Phase1
    phase2: TrainingHistory | None = None
    holdout_test: HoldoutTest | None = None
    notices: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    rivals: Rivals | None = None
    characteristics: Characteristics | None = None

    @property
    def choice_held_out_rmse(self) -> float | None:
        """Free-run RMSE on operating points that neither fitted nor chose the structure.

        See `held_out_errors_of_choice`; None where no structure was chosen.
        """
        if not self.candidates:
            return None
        return float(np.sqrt(np.mean(held_out_errors_of_choice(self.candidates) ** 2)))


@double_precision
def describe_channel(trace: ChannelTrace) -> dict:
    """Return how one direction was identified: dead zone, parameters, search, losses, notices.

    What is not finite (the standard error of an undetermined parameter) is null.
    """
    dead_zone, phase1, phase2, holdout_test = trace.dead_zone, trace.phase1, trace.phase2, trace.holdout_test
    search, objective = phase1.fit.search_result, phase1.fit.searched
    # A smaller form may have been searched: of its parameters those that the model has.
    names = {estimate.name for estimate in phase1.parameter_estimates}
    columns = zip(objective.spec.parameters, objective.values(search.best_trace).T, strict=True)
    searched = {parameter.name: column for parameter, column in columns if parameter.name in names}
    return {
        "dead_zone": {key: getattr(dead_zone, key) for key in ("value", "spread", "count", "origin")},
        "characteristics": None if trace.characteristics is None else asdict(trace.characteristics),
        "phase1": {
            "uncertainty": asdict(phase1.assessment),
            "rmse": phase1.rmse,
            "rmse_before_polish": phase1.search_rmse,
            "evaluations": search.evaluations,
            "failures": search.failures,
            "reason": search.reason,
            "fitness": [_finite(value) for value in search.fitness_trace],
            "searched": list(searched),
            "values": np.column_stack(list(searched.values())).tolist(),
        },
        "phase2": phase2
        and {
            "training_loss": [_finite(value) for value in phase2.training],
            "validation_loss": [_finite(value) for value in phase2.validation],
            "best_epoch": phase2.best_epoch,
            "reason": phase2.stop_reason.value,
        },
        "gate": holdout_test
        and {
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


@dataclass(frozen=True, repr=False)
class Identification(Summarised):
    """An identified model and the trace of its identification.

    Attributes:
        model: the grey-box model.
        channels: direction to trace.
    """

    model: Hitch
    channels: Mapping[str, ChannelTrace]

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the model folder with its traces.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """
        save(self.model, folder, trace=self.describe(), force=force)

    def describe(self) -> dict[str, dict]:
        """Return direction to trace as JSON values."""
        return {direction: describe_channel(trace) for direction, trace in self.channels.items()}

    def free_run_errors(self) -> str:
        """Return the free-run RMSE of the physics models as a sentence, on held-out tests where there are."""
        unit = self.model.units[DISPLACEMENT]
        held_out = {name: trace.choice_held_out_rmse for name, trace in self.channels.items()}
        errors = {
            name: trace.phase1.rmse if held_out[name] is None else held_out[name]
            for name, trace in self.channels.items()
        }
        figures = ", ".join(f"{name} {rmse:.3g} {unit}" for name, rmse in errors.items())
        where = "identification tests" if None in held_out.values() else "tests held out in turn"
        return f"RMSE in free run {figures} on {where}"

    def _summary(self) -> Table:
        unit = self.model.units[DISPLACEMENT]
        fits = [
            f"{direction}: RMSE {trace.phase1.rmse:.4g} {unit} in free run on the identification tests, "
            f"identified in {sum(trace.seconds.values()):.3g} s"
            for direction, trace in self.channels.items()
        ]
        notices = [f"{name}: {notice}" for name, trace in self.channels.items() for notice in trace.notices]
        shown = first_notes(notices, MAX_NOTICES, "channels")
        title = f"Identification: {' and '.join(self.channels)} at {self.model.step_s:g} s"
        return replace(hitch_summary(self.model), title=title, notes=(*fits, *shown))
