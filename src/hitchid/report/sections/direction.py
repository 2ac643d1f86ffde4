"""One direction of a model: how it errs, how far it can be trusted, its parameters, how it was found."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchid.data.record import COMMAND, DISPLACEMENT, Record
from hitchid.model import Hitch
from hitchid.report import figures
from hitchid.report.document import Block, Picture, Pictures, ReportSection, Text, sentence
from hitchid.uncertainty import characteristic_sentences
from hitchid.validation import Predictions
from hitchid.validation.tables import accuracy_table, horizon_table, single_test_table
from hitchid.validation.trust_tables import (
    band_table,
    characteristic_tables,
    parameter_table,
    residual_table,
    search_table,
)

MAX_SHOWN_TESTS = 4
COMPARED_MODELS = ("lstm", "narx", "arx", "transfer_function", "benchmark", "free_run")


@dataclass(frozen=True)
class DirectionContext:
    """What is known of one direction.

    Attributes:
        direction: lifting or lowering.
        metrics: its entry under `channels` in `metrics.json`.
        predictions: on the unseen tests.
        trace: its entry in the model folder's `trace.json`; empty where there is none.
        model: the hitch.
        tests, ramps: logs of this direction, in the logs' units.
        unit: of the displacement in the logs.
    """

    direction: str
    metrics: Mapping[str, Any]
    predictions: Predictions
    trace: Mapping[str, Any]
    model: Hitch
    tests: Sequence[Record]
    ramps: Sequence[Record]
    unit: str

    @property
    def command_unit(self) -> str:
        """Unit of the command in the model."""
        return self.model.units[COMMAND[self.direction]]

    def figure_name(self, name: str) -> str:
        """Return the name of a figure of this direction."""
        return f"{self.direction}-{name}"


def shown_tests(tests: Predictions, model: str = "free_run") -> tuple[Predictions, str]:
    """Return no more tests than can be told apart, from the best to the worst, and how they were picked."""
    count = len(tests.names)
    if count <= MAX_SHOWN_TESTS:
        return tests, "all unseen tests"
    order = np.argsort(tests.rmse(model))
    selected = sorted(
        {int(order[round(position)]) for position in np.linspace(0, count - 1, MAX_SHOWN_TESTS)}
    )
    best, worst = tests.names[order[0]], tests.names[order[-1]]
    return tests.take(
        selected
    ), f"{len(selected)} of {count} unseen tests, {best} the best, {worst} the worst"


def accuracy(context: DirectionContext) -> ReportSection:
    """Return the section on how far the model errs beside every baseline."""
    tests, metrics, unit = context.predictions, context.metrics, context.unit
    models = [name for name in COMPARED_MODELS if name in tests.models]
    pictures = (
        Picture(
            context.figure_name("horizons"),
            figures.horizons(metrics["horizons"], context.model.step_s, unit),
            "Error over how far is looked ahead. A model is of use where it lies below persistence.",
            f"RMSE in {unit} over the horizon for each model, from one sample on.",
        ),
        Picture(
            context.figure_name("tests"),
            figures.errors_by_test(tests, unit, models),
            "Error of every unseen test in free run; the bar is the figure over all tests.",
            f"RMSE of each of {len(tests.names)} tests in free run, for {len(models)} models.",
        ),
    )
    tables = (
        accuracy_table(context.direction, metrics, unit),
        horizon_table(context.direction, metrics, unit),
    )
    return ReportSection("Accuracy", (*tables, Pictures(pictures)))


def errors(context: DirectionContext) -> ReportSection:
    """Return the section on the errors themselves: over time, distributed, test by test."""
    tests, unit = context.predictions, context.unit
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    models_equal = all(map(np.array_equal, tests.models["benchmark"], tests.models["free_run"]))
    equal_note = " In free run the grey box is the benchmark alone." if models_equal else ""
    models = ("free_run", "one_step") if models_equal else ("benchmark", "free_run", "one_step")
    free = context.metrics["greybox"]["free_run"]["rmse"]
    pictures = [
        Picture(
            context.figure_name("outputs"),
            figures.outputs(selected_tests, unit, models),
            f"Measured and predicted displacement, and the errors: {selection_text} ({names}).{equal_note}",
            f"Displacement and error over time of {names}; the free run errs by {_format_error(free)} {unit} RMSE.",
        ),
        Picture(
            context.figure_name("distribution"),
            figures.error_distribution({name: tests.errors(name) for name in reversed(models)}, unit),
            "Errors on all unseen tests: histogram with fitted normal, and the share of samples below a "
            "limit. The axes end where 99.5 % of the samples lie.",
            f"Histogram and cumulative distribution of errors in {unit}.",
        ),
    ]
    if context.model.channels[context.direction].compensator is not None:
        pictures.append(
            Picture(
                context.figure_name("predicted-errors"),
                figures.predicted_errors({"test": tests}, unit),
                "What the benchmark misses, and what the compensator says of it one step ahead.",
                f"Benchmark's error in {unit} over the sample, actual and predicted.",
            )
        )
    table = single_test_table(context.direction, context.metrics["per_test"], unit)
    return ReportSection("Errors", (Pictures(tuple(pictures)), table))


def trust(context: DirectionContext) -> ReportSection:
    """Return the section on bands, and on what the errors still show."""
    metrics, unit = context.metrics, context.unit
    blocks: list[Block] = []
    pictures = []
    if "bands" in metrics:
        blocks.append(band_table(context.direction, metrics["bands"], unit))
        pictures.append(
            Picture(
                context.figure_name("coverage"),
                figures.coverage(metrics["bands"], context.model.step_s),
                "Share of unseen samples that the bands hold, against the share they are made for.",
                "Coverage of the bands in percent over the horizon.",
            )
        )
    free = metrics.get("residuals", {}).get("free_run")
    if free is not None:
        blocks.append(residual_table(context.direction, metrics["residuals"], unit))
        pictures += [
            Picture(
                context.figure_name("correlations"),
                figures.residual_correlations(free),
                "Free run: correlation of the errors with themselves and with the command. Beyond the bounds "
                "is what a model could still explain.",
                "Autocorrelation of the errors and their correlation with the command, with 99 % bounds.",
            ),
            Picture(
                context.figure_name("places"),
                figures.residuals_by_variable(free, unit, context.command_unit),
                "Free run: mean error (bar) and its spread (line) by displacement, speed and command beyond "
                "the dead zone. A bar off zero shows where the model is wrong.",
                f"Mean and spread of the errors in {unit} by displacement, speed and command.",
            ),
        ]
    return ReportSection("Trust", (*blocks, *_picture_group(pictures)))


def parameters(context: DirectionContext) -> ReportSection:
    """Return the section on parameters with their intervals, the map of the valve, the dead zone."""
    metrics, model, direction = context.metrics, context.model, context.direction
    blocks: list[Block] = []
    pictures = []
    uncertainty = model.uncertainty.get(direction)
    if uncertainty is not None and uncertainty.characteristics is not None and "characteristics" in metrics:
        sentences = [
            sentence(text) for text in characteristic_sentences(uncertainty.characteristics, direction)
        ]
        blocks += [Text(" ".join(sentences)), *characteristic_tables(direction, metrics["characteristics"])]
        pictures.append(
            Picture(
                context.figure_name("speed-map"),
                figures.speed_map(uncertainty.characteristics),
                "Speed map: steady speed at mid stroke over the command, as the fitted form has it, with its "
                "95 % band; open circles are mean speeds of identification tests while their command stood."
                + (
                    f" One line for each load ({uncertainty.characteristics.load})."
                    if metrics["characteristics"]["load"]
                    else ""
                ),
                " ".join(sentences),
            )
        )
    tests = [model.to_model_units(record) for record in context.tests]
    ramps = [model.to_model_units(record) for record in context.ramps]
    unit = model.units[DISPLACEMENT]
    channel = model.channels[direction]
    pictures.append(
        Picture(
            context.figure_name("valve"),
            figures.valve_map(channel, tests, ramps, unit, context.command_unit),
            "Map of the valve: speed over command. Below the dead zone, points show motion dying away.",
            f"Speed in {unit}/s over command in {context.command_unit}: benchmark, tests and ramps.",
        )
    )
    for key, title, name in (
        ("parameters", f"{direction}: parameters of the benchmark", "intervals"),
        ("paper_parameters", f"{direction}: parameters of the paper's transfer function", "paper-intervals"),
    ):
        if key in metrics and metrics[key]["estimates"]:
            blocks.append(parameter_table(title, metrics[key]))
            pictures.append(
                Picture(
                    context.figure_name(name),
                    figures.intervals(metrics[key]),
                    f"{title.partition(': ')[2].capitalize()}: estimate and 95 % interval, each on its own "
                    "scale; the thin line is the bootstrap's. Grey: not determined by the tests.",
                    "; ".join(
                        f"{estimate['symbol']}: {estimate['verdict']}"
                        for estimate in metrics[key]["estimates"].values()
                    ),
                )
            )
    zone = context.trace.get("dead_zone")
    if ramps and zone and zone["value"] > 0:
        pictures.append(
            Picture(
                context.figure_name("dead-zone"),
                figures.dead_zone(
                    ramps, direction, zone["value"], zone["spread"], unit, context.command_unit
                ),
                _dead_zone_caption(zone),
                f"Way of the piston over command on {len(ramps)} ramps; dead zone {zone['value']:.4g} "
                f"{context.command_unit}.",
            )
        )
    return ReportSection("Parameters", (*blocks, *_picture_group(pictures)))


def search(context: DirectionContext) -> ReportSection:
    """Return the section on how the model was found; its trace is in the model's units."""
    trace, unit = context.trace, context.model.units[DISPLACEMENT]
    blocks: list[Block] = []
    pictures = []
    if trace:
        blocks += [Text(sentence(notice)) for notice in trace["notices"]]
        pictures.append(
            Picture(
                context.figure_name("convergence"),
                figures.convergence(trace, unit),
                "Search: best fitness so far, over the tests as the search weighs them, and the parameters "
                "that gave it.",
                "Best RMSE and the parameters that gave it, over the iterations of the search.",
            )
        )
        if trace["phase2"]:
            pictures.append(
                Picture(
                    context.figure_name("losses"),
                    figures.losses(trace),
                    "Training of the compensator; the epoch with the least validation loss is kept.",
                    f"Losses over epochs; that of epoch {trace['phase2']['best_epoch']} is kept.",
                )
            )
        if trace["candidates"]:
            chosen = next(candidate["name"] for candidate in trace["candidates"] if candidate["chosen"])
            pictures.append(
                Picture(
                    context.figure_name("structures"),
                    figures.structures(trace["candidates"], unit),
                    "Structures compared in free run, on all tests and on levels held out in turn. A gain "
                    "that grows along the stroke is judged with each test's own speed, so it may be taken "
                    "with a larger error here.",
                    f"RMSE of {len(trace['candidates'])} structures; taken: {chosen}.",
                )
            )
    if "searches" in context.metrics:
        blocks.append(search_table(context.direction, context.metrics["searches"], context.unit))
        pictures.append(
            Picture(
                context.figure_name("searches"),
                figures.searches(context.metrics["searches"], context.unit),
                "Searches compared on one budget: the run in the middle, and where each seed ended.",
                f"Best RMSE over the budget for {', '.join(context.metrics['searches'])}.",
            )
        )
    return ReportSection("Search and training", (*blocks, *_picture_group(pictures)))


def _dead_zone_caption(zone: Mapping[str, Any]) -> str:
    """Return where a dead zone comes from, as a caption."""
    if zone["origin"] == "ramps":
        return f"Dead zone from {zone['count']} slow ramps, ± its spread: where they set the piston moving."
    if zone["origin"] == "tests":
        return f"Dead zone from {zone['count']} dynamic tests, ± its standard error; the ramps were not used."
    return "Dead zone as it was given; the ramps were not used."


def _picture_group(pictures: Sequence[Picture]) -> tuple[Pictures, ...]:
    return (Pictures(tuple(pictures)),) if pictures else ()


def _format_error(value: float | None) -> str:
    return "more than can be told" if value is None else f"{value:.3g}"
