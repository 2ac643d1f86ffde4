"""Results of a validation as frozen records: one layout for directions and for mixed cycles."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import ascii_uppercase

import numpy as np

from hitchid._support.metrics import SIGNIFICANCE, better_p_value, error_figures, rmse_error
from hitchid._support.numbers import count, digits
from hitchid._support.records import Value, short_repr
from hitchid._support.screen import sparkline
from hitchid._support.tables import Table
from hitchid.baselines.registry import BASELINES, all_baselines
from hitchid.logs.record import COMMAND, Record
from hitchid.model import Characteristics, Estimates, LoadScatter, SearchSummary
from hitchid.validation.residuals import ResidualTests

# Predictions of models on tests, sample by sample.

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

    @classmethod
    def of(
        cls,
        tests: Sequence[Record],
        models: Mapping[str, Sequence[np.ndarray]],
        factor: float,
        *,
        band: tuple[Sequence[np.ndarray], Sequence[np.ndarray]] | None = None,
    ) -> "Predictions":
        """Return tests with the predictions of models, one array [N_i] a test, all times a factor."""

        def scaled(rows: Iterable[np.ndarray]) -> Rows:
            return tuple(factor * row for row in rows)

        commands = dict.fromkeys(r for test in tests for r in COMMAND.values() if r in test.signals)
        return cls(
            names=tuple(test.name for test in tests),
            time_s=tuple(test.step_s * np.arange(len(test)) for test in tests),
            actual=scaled(test.displacement for test in tests),
            models={name: scaled(rows) for name, rows in models.items()},
            band=None if band is None else (scaled(band[0]), scaled(band[1])),
            commands={
                name: tuple(test.signals.get(name, np.zeros(len(test))) for test in tests)
                for name in commands
            },
        )

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


# Names of models and runs, for tables, notices and figures.

CYCLES = "cycles"
GREYBOX, BENCHMARK, PERSISTENCE = "greybox", "benchmark", "persistence"
ONE_STEP, FREE_RUN = "one_step", "free_run"
NAMES = {
    PERSISTENCE: "persistence",
    **{baseline.name: baseline.title for baseline in BASELINES},
    "transfer_function": "paper's transfer function",
    "paper": "paper's grey box",
    BENCHMARK: "physics model",
    GREYBOX: "grey box",
}
RUNS = {ONE_STEP: "one step", FREE_RUN: "free run"}
LABELS = NAMES | {
    "benchmark": "physics model, free run",
    "one_step": "grey box, one step",
    "free_run": "grey box, free run",
    "mechanistic": "mechanistic, free run",
    "paper_one_step": "paper's grey box, one step",
    **{letter: f"model {letter}" for letter in ascii_uppercase[:8]},  # as many as a figure shows
}


def model_name(key: str) -> str:
    """Return the name of a model; the key where the package of a baseline is not installed."""
    if key in NAMES:  # the packages installed are asked only for names that are not our own: that takes long
        return NAMES[key]
    extensions = all_baselines()
    return extensions[key].title if key in extensions else key


def in_table_order(keys: Iterable[str]) -> list[str]:
    """Return models in the order of tables: baselines, those of other packages, benchmark, grey box."""
    present = list(keys)
    others = [key for key in present if key not in NAMES]
    ordered = [*(key for key in NAMES if key not in (BENCHMARK, GREYBOX)), *others, BENCHMARK, GREYBOX]
    return [key for key in ordered if key in present]


def label(key: str) -> str:
    """Return the name of a model and its run in a legend; the key itself for other models."""
    return LABELS.get(key, key)


# Tests that a figure shows.

MAX_SHOWN_TESTS = 4  # tests in one figure; chosen, so that curves stay distinguishable


def shown_tests(tests: Predictions, model: str = "free_run") -> tuple[Predictions, str]:
    """Return at most four tests, from the best to the worst, and a text on their selection."""
    count = len(tests.names)
    if count <= MAX_SHOWN_TESTS:
        return tests, "all unseen tests"
    order = np.argsort(tests.rmse(model))
    selected = sorted(
        {int(order[round(position)]) for position in np.linspace(0, count - 1, MAX_SHOWN_TESTS)}
    )
    best, worst = tests.names[order[0]], tests.names[order[-1]]
    selection = f"{len(selected)} of {count} unseen tests, {best} the best, {worst} the worst"
    return tests.take(selected), selection


@short_repr
@dataclass(frozen=True)
class RunFigures:
    """Errors of one model in one kind of run, pooled over tests; None where the run diverged.

    Attributes:
        rmse, mae, max_abs: root mean square, mean and largest absolute error, in the displacement's unit.
        r2: coefficient of determination, a fraction.
        fit: 100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖), percent.
        within_1: fraction of samples whose absolute error is below one unit.
        rmse_error: standard error of the RMSE; None for one test.
    """

    rmse: float | None
    mae: float | None
    r2: float | None
    fit: float | None
    max_abs: float | None
    within_1: float | None
    rmse_error: float | None = None

    @classmethod
    def of(cls, actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> "RunFigures":
        """Return the figures of predicted against measured displacement, an array [N_i] for each test."""
        figures = (*error_figures(actual, predicted), rmse_error(actual, predicted))
        return cls(*(value if np.isfinite(value) else None for value in figures))

    def value(self, figure: str) -> float | None:
        """Return one figure by its name."""
        return getattr(self, figure)

    @property
    def fit_error(self) -> float | None:
        """Standard error of the fit, percent: (100 − fit) s/r, s being that of the RMSE r; None without."""
        if self.fit is None or self.rmse_error is None or not self.rmse:
            return None
        return (100.0 - self.fit) * self.rmse_error / self.rmse

    @property
    def main(self) -> dict[str, float | None]:
        """RMSE and fit by name, with their standard errors."""
        errors = {"rmse": self.rmse, "rmse_error": self.rmse_error}
        return {**errors, "fit": self.fit, "fit_error": self.fit_error}

    def errs_less(self, other: "RunFigures") -> bool:
        """Return whether this RMSE is finite and below the other; a run that diverged is never better."""
        return self.rmse is not None and (other.rmse is None or self.rmse < other.rmse)


def figures_by_test(tests: Predictions) -> dict[str, RunFigures]:
    """Return the figures of the free run on each test alone."""
    rows = zip(tests.names, tests.actual, tests.models[FREE_RUN], strict=True)
    return {name: RunFigures.of([actual], [predicted]) for name, actual, predicted in rows}


@short_repr
@dataclass(frozen=True)
class ModelFigures:
    """Figures of one model by run; None for a run that the model does not have."""

    one_step: RunFigures | None = None
    free_run: RunFigures | None = None

    def run(self, name: str) -> RunFigures | None:
        """Return the figures of `one_step` or `free_run`."""
        return self.one_step if name == ONE_STEP else self.free_run

    def columns(self, unit: str) -> dict[str, float | None]:
        """Return RMSE in `unit` and fit in percent of each run, with standard errors, by column name."""
        columns: dict[str, float | None] = {}
        for run, figures in ((FREE_RUN, self.free_run), (ONE_STEP, self.one_step)):
            if figures is not None:
                columns |= {
                    f"{run}_{name}_{'percent' if name.startswith('fit') else unit}": value
                    for name, value in figures.main.items()
                }
        return columns


@short_repr
@dataclass(frozen=True)
class Horizons:
    """RMSE over prediction horizons.

    Attributes:
        steps: horizons, in samples.
        rmse: model to its RMSE at each horizon, in the displacement's unit; None where it diverged.
        rmse_error: model to the standard errors of these over tests; None where it diverged or for one test.
    """

    steps: tuple[int, ...]
    rmse: Mapping[str, tuple[float | None, ...]]
    rmse_error: Mapping[str, tuple[float | None, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, figures: Mapping[str, Mapping[int, RunFigures]]) -> "Horizons":
        """Return the horizons of models, each with its figures by horizon in samples."""
        return cls(
            tuple(next(iter(figures.values()))),
            {name: tuple(run.rmse for run in runs.values()) for name, runs in figures.items()},
            {name: tuple(run.rmse_error for run in runs.values()) for name, runs in figures.items()},
        )


@short_repr
@dataclass(frozen=True)
class BandHorizons:
    """Coverage of prediction bands by horizon.

    Attributes:
        steps: horizons, in samples.
        covered: share of samples inside the band.
        width: full width of the band, in the displacement's unit.
    """

    steps: tuple[int, ...]
    covered: tuple[float, ...]
    width: tuple[float, ...]


@short_repr
@dataclass(frozen=True)
class BandFigures:
    """Coverage of prediction bands on unseen tests, each test weighing the same.

    Attributes:
        coverage: nominal share of samples.
        covered: share of samples inside the band of the free run.
        covered_error: its standard error over tests; None for one test.
        width: mean width of that band, in the displacement's unit.
        calibrated_on: number of held-out tests of the bands of free run and of horizons; None for cycles.
        sensor_noise: standard deviation, in the displacement's unit; None for cycles.
        horizons: bands of predictions over horizons; None for cycles.
    """

    coverage: float
    covered: float
    covered_error: float | None
    width: float
    calibrated_on: tuple[int, int] | None = None
    sensor_noise: float | None = None
    horizons: BandHorizons | None = None


@short_repr
@dataclass(frozen=True)
class Accuracy:
    """Errors of every model on the unseen tests of one direction, or on the unseen mixed cycles.

    Attributes:
        models: name of a model, `greybox`, `benchmark` or a baseline, to its figures.
        horizons: of every model that predicts over horizons.
        per_test: test to the grey box's figures in free run.
        predictions: the tests and the predictions that the figures are computed from.
        bands: of the grey box; None where it has none, or where its free run diverged.
    """

    models: Mapping[str, ModelFigures]
    horizons: Horizons
    per_test: Mapping[str, RunFigures]
    predictions: Predictions
    bands: BandFigures | None = None

    @property
    def tests(self) -> tuple[str, ...]:
        """Names of the tests."""
        return self.predictions.names

    def free_run(self, model: str = GREYBOX) -> RunFigures:
        """Return the figures of the grey box or the benchmark in free run.

        Raises:
            KeyError: the model has no free run.
        """
        figures = self.models[model].free_run
        if figures is None:
            raise KeyError(f"{model} has no free run")
        return figures

    @property
    def uncompensated(self) -> bool:
        """Whether the grey box in free run is the benchmark alone."""
        return self.free_run() == self.free_run(BENCHMARK)


def errors_summary(
    title: str,
    unit: str,
    accuracies: Mapping[str, Accuracy],
    rows: Iterable[tuple[str, str, ModelFigures, Accuracy | None]],
    notes: tuple[str, ...],
) -> Table:
    """Return the main figures of models, as a validation and a comparison show them."""
    tests = ", ".join(
        count(len(accuracy.tests), "unseen cycle" if section == CYCLES else f"unseen {section} test")
        for section, accuracy in accuracies.items()
    )
    cells, pictures = [], []
    for section, name, figures, pictured in rows:
        step, free = figures.one_step, figures.free_run
        errors = ("", "", "") if free is None else map(digits, (free.rmse, free.fit, free.max_abs))
        cells.append((section, name, "" if step is None else digits(step.rmse), *errors))
        picture = ""
        if pictured is not None:
            shown = pictured.predictions
            measured, predicted = shown.actual[0], shown.models[FREE_RUN][0]
            label_text = f"{section}: {shown.names[0]}, measured and in free run"
            picture = sparkline([measured, predicted], label_text, [measured, measured])
        pictures.append(picture)
    header = (f"RMSE one step / {unit}", f"RMSE free run / {unit}", "fit / %", f"largest / {unit}")
    return Table(f"{title} {tests}", ("direction", "model", *header), tuple(cells), notes, tuple(pictures))


@short_repr
@dataclass(frozen=True)
class ChannelResult:
    """Results of one direction.

    Attributes:
        accuracy: on the unseen tests.
        residuals: run to tests of the grey box's errors; None where the run diverged.
        parameters, paper_parameters: estimates of the benchmark's parameters and of the paper's transfer
            function, in the model's units; None if the model has none.
        characteristics: speed map, dead zone, delay and response time; None if the model has none.
        load_scatter: scatter of the speed between identification tests; None if the model has none.
        searches: compared search algorithms; empty if they were not compared.
    """

    accuracy: Accuracy
    residuals: Mapping[str, ResidualTests | None]
    parameters: Estimates | None = None
    paper_parameters: Estimates | None = None
    characteristics: Characteristics | None = None
    load_scatter: LoadScatter | None = None
    searches: tuple[SearchSummary, ...] = ()


@short_repr
@dataclass(frozen=True)
class CycleResult:
    """Results of the unseen mixed cycles.

    Attributes:
        accuracy: on the unseen cycles.
        max_jump: largest jump of the free run where the channel changes, in the displacement's unit; None
            where it diverged.
    """

    accuracy: Accuracy
    max_jump: float | None
