"""The result of a validation, with its files and its report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.files import canonical_json, write_bytes, write_files, write_folder
from hitchid._support.records import Value
from hitchid._support.screen import first_notes
from hitchid._support.tables import DataTable, Summarised, Table, csv_files
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import COMMAND
from hitchid.model import Hitch, TwoModes
from hitchid.validation.acceptance import Acceptance, check_limits
from hitchid.validation.limits import AcceptanceLimits
from hitchid.validation.metrics_json import validation_json
from hitchid.validation.report_data import ReportData, log_uses, report_data
from hitchid.validation.results import (
    BENCHMARK,
    CYCLES,
    FREE_RUN,
    GREYBOX,
    RUNS,
    Accuracy,
    ChannelResult,
    CycleResult,
    Predictions,
    errors_summary,
    in_table_order,
    model_name,
)
from hitchid.validation.tables import log_table, validation_tables

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hitchid.report import ChannelTraceFile, Document

METRICS_FILE = "metrics.json"
TABLES_FILE = "tables.md"
MAX_NOTICES = 3  # that a summary shows; chosen


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Value, Summarised):
    """Errors of a model and its baselines on tests that the identification did not use.

    Attributes:
        unit: of the displacement in the logs, and of every error.
        channels: direction to its results.
        cycles: results of the mixed cycles; None where there are none.
        mode_test: test of one shared model against one for each direction; None where it was not made.
        notices: warnings on the figures.
        model, campaign: the validated model and the logs.
    """

    unit: str
    channels: Mapping[str, ChannelResult]
    cycles: CycleResult | None
    mode_test: TwoModes | None
    notices: tuple[str, ...]
    model: Hitch = field(repr=False, compare=False)
    campaign: Campaign = field(repr=False, compare=False)

    @property
    def accuracy(self) -> dict[str, Accuracy]:
        """Errors by direction, and under `cycles` those of mixed cycles."""
        by_direction = {direction: result.accuracy for direction, result in self.channels.items()}
        return by_direction if self.cycles is None else {**by_direction, CYCLES: self.cycles.accuracy}

    @property
    def predictions(self) -> dict[str, Predictions]:
        """Unseen tests with the predictions of every model, by direction, and under `cycles` mixed cycles."""
        return {direction: accuracy.predictions for direction, accuracy in self.accuracy.items()}

    @property
    def metrics(self) -> dict[str, object]:
        """All figures, the content of `metrics.json`: errors in `unit`, R² a fraction, fit in percent."""
        return validation_json(self.unit, self.channels, self.cycles, self.mode_test)

    def tables(self) -> dict[str, DataTable]:
        """Return every table as data by name: those of each direction, of mixed cycles, and the logs.

        Numbers have full precision and units are in the names of the columns, such as `rmse_mm`.
        """
        results = validation_tables(self.unit, self.channels, self.cycles, self.model.units)
        all_tables = [*results, log_table(log_uses(self.model, self.campaign)).data()]
        return {table.name: table for table in all_tables}

    def check(self, limits: AcceptanceLimits) -> Acceptance:
        """Compare the figures with limits; see `check_limits`."""
        return check_limits(self.unit, self.accuracy, limits)

    def plot(
        self,
        axes: "Sequence[Axes] | np.ndarray | None" = None,
        *,
        section: str | None = None,
        test: str | None = None,
        models: Sequence[str] | None = None,
    ) -> np.ndarray:
        """Draw measured on top of predicted displacement with the band of the free run, and errors below.

        Args:
            axes: two matplotlib axes to draw into; None for a new figure of pyplot.
            section: a direction or `cycles`; None for the first of `accuracy`.
            test: name of one unseen test; None for at most four, from the best to the worst.
            models: keys of `predictions[section].models`; None for the free run of the grey box, and of the
                benchmark where it differs.

        Returns:
            The two axes.

        Raises:
            InputError: there is no such section, test or model, or other than two axes are given.
        """
        from hitchid.validation.plotting import plot_fit

        section = checks.one_of(section or next(iter(self.accuracy)), self.accuracy, "section")
        tests = self.predictions[section]
        if models is None:
            models = (FREE_RUN,) if tests.uncompensated else (BENCHMARK, FREE_RUN)
        return plot_fit(tests, models, axes, section=section, test=test, unit=self.unit)

    def plot_residuals(
        self,
        axes: "Sequence[Axes] | np.ndarray | None" = None,
        *,
        section: str | None = None,
        run: str = FREE_RUN,
    ) -> np.ndarray:
        """Draw correlations of the errors with 99 % bounds, and mean and spread of the errors over variables.

        Args:
            axes: five matplotlib axes to draw into: autocorrelation, correlation with the command, and errors
                over displacement, speed and command; None for a new figure of pyplot.
            section: a direction; None for the first.
            run: `free_run` or `one_step`.

        Returns:
            The five axes; those of a run that diverged say so.

        Raises:
            InputError: there is no such direction or run, or other than five axes are given.
        """
        from hitchid.validation.plotting import plot_residuals

        section = checks.one_of(section or next(iter(self.channels), ""), self.channels, "section")
        residuals = self.channels[section].residuals
        return plot_residuals(
            residuals[checks.one_of(run, residuals, "run")],
            axes,
            title=f"{section}, {RUNS[run]}",
            unit=self.unit,
            command_unit=self.model.units[COMMAND[section]],
        )

    def report_data(self) -> ReportData:
        """Return the further content of a report: logs, their audit, speed over command, origin."""
        return report_data(self.model, self.campaign)

    def report(
        self,
        *,
        trace: Mapping[str, "ChannelTraceFile"] | None = None,
        acceptance: Acceptance | None = None,
        command: str = "",
    ) -> "Document":
        """Return the report, for `hitchid.report.render`.

        Args:
            trace: trace of the identification, as `hitchid.report.read_trace` returns it.
            acceptance: result of the acceptance limits; None without limits.
            command: the command line that wrote the report.
        """
        from hitchid.report.validation_report import validation_report

        return validation_report(
            self, self.report_data(), trace=trace, acceptance=acceptance, command=command
        )

    def markdown(self) -> str:
        """Return every table as Markdown."""
        from hitchid.report import render, validation_tables

        return render(validation_tables(self), "markdown").decode("utf-8", errors="surrogateescape")

    def to_html(self, path: str | Path, *, force: bool = False) -> None:
        """Write the report as one HTML page.

        Raises:
            OutputError: the file exists and `force` is not given, or it cannot be written.
        """
        self.write_as("html", path, force=force)

    def to_pdf(self, path: str | Path, *, force: bool = False) -> None:
        """Write the report as PDF.

        Raises:
            OutputError: the file exists and `force` is not given, or it cannot be written.
            InputError: typst is not installed.
        """
        self.write_as("pdf", path, force=force)

    def write_as(self, renderer: str, path: str | Path, *, force: bool = False) -> None:
        """Write the report with one of `hitchid.report.registered_renderers()`.

        Raises:
            OutputError: the file exists and `force` is not given, or it cannot be written.
            InputError: there is no such renderer.
        """
        from hitchid.report import render

        write_bytes(checks.path(path, "path"), render(self.report(), renderer), force=force)

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the files of `files`, all or none; `report.write_report` adds a report.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """
        write_folder(
            checks.path(folder, "folder"),
            lambda target: write_files(target, self.files()),
            result_kind=METRICS_FILE,
            force=force,
        )

    def files(self) -> dict[str, bytes]:
        """Return `metrics.json`, `tables.md` and `tables/*.csv` with their content."""
        text = self.markdown().encode("utf-8", errors="backslashreplace")
        return {
            METRICS_FILE: canonical_json(self.metrics),
            TABLES_FILE: text,
            **csv_files(self.tables().values()),
        }

    def _summary(self) -> Table:
        rows = [
            (section, model_name(name), accuracy.models[name], accuracy if name == GREYBOX else None)
            for section, accuracy in self.accuracy.items()
            for name in reversed(in_table_order(accuracy.models))
        ]
        notes = first_notes(self.notices, MAX_NOTICES, "notices")
        return errors_summary("Validation on", self.unit, self.accuracy, rows, notes)
