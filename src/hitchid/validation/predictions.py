"""Predictions of models on tests, sample by sample."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hitchid._support.metrics import SIGNIFICANCE, better_p_value
from hitchid._support.short_repr import short_repr
from hitchid._support.values import Value
from hitchid.data.record import COMMAND, Record

MIN_TESTS = 3  # fewest tests for a significance test; fewer do not determine the variance
Rows = tuple[np.ndarray, ...]


@short_repr
@dataclass(frozen=True, eq=False)
class Predictions(Value):
    """Tests and the predictions of models, one array of shape [N_i] for each test, all in the tests' unit.

    Attributes:
        names: of the tests.
        time_s: time since the start of each test, s.
        actual: measured displacement.
        models: name to predicted displacement: `benchmark` and `free_run` from commands alone, `one_step`
            from the measurements up to the sample before.
        band: lower and upper end of a band around `free_run`; None where there is none.
        commands: name of a command to its values, in the model's unit; empty where they are not given.
    """

    names: tuple[str, ...]
    time_s: Rows
    actual: Rows
    models: Mapping[str, Rows]
    band: tuple[Rows, Rows] | None = None
    commands: Mapping[str, Rows] = field(default_factory=dict)

    def take(self, indices: Iterable[int]) -> "Predictions":
        """Return some of the tests."""
        selected = list(indices)

        def select(rows: Rows) -> Rows:
            return tuple(rows[i] for i in selected)

        return Predictions(
            names=tuple(self.names[i] for i in selected),
            time_s=select(self.time_s),
            actual=select(self.actual),
            models={name: select(rows) for name, rows in self.models.items()},
            band=None if self.band is None else (select(self.band[0]), select(self.band[1])),
            commands={name: select(rows) for name, rows in self.commands.items()},
        )

    def errors(self, model: str) -> np.ndarray:
        """Return actual minus predicted over all tests, without the first sample of each, shape [M]."""
        return np.concatenate([a[1:] - p[1:] for a, p in zip(self.actual, self.models[model], strict=True)])

    @property
    def uncompensated(self) -> bool:
        """Whether `free_run` is `benchmark` in every test: the model corrects nothing in free run."""
        return all(map(np.array_equal, self.models["benchmark"], self.models["free_run"]))

    def rmse(self, model: str) -> np.ndarray:
        """Return the root mean square error of each test, infinite where the model diverged, shape [T]."""
        pairs = zip(self.actual, self.models[model], strict=True)
        with np.errstate(over="ignore", invalid="ignore"):
            errors = np.array([np.sqrt(np.mean((a - p) ** 2)) for a, p in pairs])
        return np.where(np.isfinite(errors), errors, np.inf)

    def better_p_value(self, model: str, other: str) -> float:
        """Return the p-value of one model's RMSE being below another's, 1 with fewer than three tests.

        See `better_p_value` in `_support/metrics.py`.
        """
        samples = np.array([row.size for row in self.actual])
        if len(samples) < MIN_TESTS:
            return 1.0
        return better_p_value(self.rmse(model), self.rmse(other), samples)

    def is_significantly_better(self, model: str, other: str) -> bool:
        """Return whether one model's RMSE is below another's at a significance of 2.5 %, one-sided."""
        return self.better_p_value(model, other) < SIGNIFICANCE


def concatenate_tests(tests: Sequence[np.ndarray]) -> np.ndarray:
    """Return concatenated tests; NaN replaces the first sample, which is the initial value, as a gap."""
    return np.concatenate([np.append(np.nan, test[1:]) for test in tests])


def concatenated_time(tests: Predictions) -> np.ndarray:
    """Return the time of concatenated tests, s."""
    shifted_times, start = [], 0.0
    for time_s in tests.time_s:
        shifted_times.append(start + time_s)
        start += float(time_s[-1])
    return np.concatenate(shifted_times)


def commands_of(records: Sequence[Record]) -> dict[str, Rows]:
    """Return the commands of records, name to values."""
    names = dict.fromkeys(role for record in records for role in COMMAND.values() if role in record.signals)
    return {
        name: tuple(record.signals.get(name, np.zeros(len(record))) for record in records) for name in names
    }
