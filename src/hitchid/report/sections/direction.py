"""One direction of a model: how it errs, how far it can be trusted, its parameters, how it was found."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchid.data.record import COMMAND, DISPLACEMENT, Record
from hitchid.model import Hitch
from hitchid.report import figures
from hitchid.report.document import Block, Picture, Pictures, Section, Text, sentence
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

SHOWN = 4
RIVALS = ("lstm", "narx", "arx", "transfer_function", "benchmark", "free_run")


@dataclass(frozen=True)
class Direction:
    """What is known of one direction.

    Attributes:
        mode: lifting or lowering.
        metrics: its entry under `channels` in `metrics.json`.
        predictions: on the unseen tests.
        trace: its entry in the model folder's `trace.json`; empty where there is none.
        model: the hitch.
        tests, ramps: logs of this direction, in the logs' units.
        unit: of the displacement in the logs.
    """

    mode: str
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
        return self.model.units[COMMAND[self.mode]]

    def named(self, name: str) -> str:
        """Return the name of a figure of this direction."""
        return f"{self.mode}-{name}"


def shown_tests(tests: Predictions, model: str = "free_run") -> tuple[Predictions, str]:
    """Return no more tests than can be told apart, from the best to the worst, and how they were picked."""
    count = len(tests.names)
    if count <= SHOWN:
        return tests, "all unseen tests"
    order = np.argsort(tests.rmse(model))
    picked = sorted({int(order[round(place)]) for place in np.linspace(0, count - 1, SHOWN)})
    best, worst = tests.names[order[0]], tests.names[order[-1]]
    return tests.take(picked), f"{len(picked)} of {count} unseen tests, {best} the best, {worst} the worst"


def accuracy(known: Direction) -> Section:
    """Return the section on how far the model errs beside every baseline."""
    tests, metrics, unit = known.predictions, known.metrics, known.unit
    rivals = [name for name in RIVALS if name in tests.models]
    pictures = (
        Picture(
            known.named("horizons"),
            figures.horizons(metrics["horizons"], known.model.step_s, unit),
            "Error over how far is looked ahead. A model is of use where it lies below persistence.",
            f"RMSE in {unit} over the horizon for each model, from one sample on.",
        ),
        Picture(
            known.named("tests"),
            figures.errors_by_test(tests, unit, rivals),
            "Error of every unseen test in free run; the bar is the figure over all tests.",
            f"RMSE of each of {len(tests.names)} tests in free run, for {len(rivals)} models.",
        ),
    )
    tables = (accuracy_table(known.mode, metrics, unit), horizon_table(known.mode, metrics, unit))
    return Section("Accuracy", (*tables, Pictures(pictures)))


def errors(known: Direction) -> Section:
    """Return the section on the errors themselves: over time, distributed, test by test."""
    tests, unit = known.predictions, known.unit
    some, picked = shown_tests(tests)
    names = ", ".join(some.names)
    same = all(map(np.array_equal, tests.models["benchmark"], tests.models["free_run"]))
    alike = " In free run the grey box is the benchmark alone." if same else ""
    models = ("free_run", "one_step") if same else ("benchmark", "free_run", "one_step")
    free = known.metrics["greybox"]["free_run"]["rmse"]
    pictures = [
        Picture(
            known.named("outputs"),
            figures.outputs(some, unit, models),
            f"Measured and predicted displacement, and the errors: {picked} ({names}).{alike}",
            f"Displacement and error over time of {names}; the free run errs by {_short(free)} {unit} RMSE.",
        ),
        Picture(
            known.named("distribution"),
            figures.error_distribution({name: tests.errors(name) for name in reversed(models)}, unit),
            "Errors on all unseen tests: histogram with fitted normal, and the share of samples below a "
            "limit. The axes end where 99.5 % of the samples lie.",
            f"Histogram and cumulative distribution of errors in {unit}.",
        ),
    ]
    if known.model.channels[known.mode].compensator is not None:
        pictures.append(
            Picture(
                known.named("predicted-errors"),
                figures.predicted_errors({"test": tests}, unit),
                "What the benchmark misses, and what the compensator says of it one step ahead.",
                f"Benchmark's error in {unit} over the sample, actual and predicted.",
            )
        )
    table = single_test_table(known.mode, known.metrics["per_test"], unit)
    return Section("Errors", (Pictures(tuple(pictures)), table))


def trust(known: Direction) -> Section:
    """Return the section on bands, and on what the errors still show."""
    metrics, unit = known.metrics, known.unit
    blocks: list[Block] = []
    pictures = []
    if "bands" in metrics:
        blocks.append(band_table(known.mode, metrics["bands"], unit))
        pictures.append(
            Picture(
                known.named("coverage"),
                figures.coverage(metrics["bands"], known.model.step_s),
                "Share of unseen samples that the bands hold, against the share they are made for.",
                "Coverage of the bands in percent over the horizon.",
            )
        )
    free = metrics.get("residuals", {}).get("free_run")
    if free is not None:
        blocks.append(residual_table(known.mode, metrics["residuals"], unit))
        pictures += [
            Picture(
                known.named("correlations"),
                figures.residual_correlations(free),
                "Free run: correlation of the errors with themselves and with the command. Beyond the bounds "
                "is what a model could still explain.",
                "Autocorrelation of the errors and their correlation with the command, with 99 % bounds.",
            ),
            Picture(
                known.named("places"),
                figures.residuals_by_place(free, unit, known.command_unit),
                "Free run: mean error (bar) and its spread (line) by displacement, speed and command beyond "
                "the dead zone. A bar off zero shows where the model is wrong.",
                f"Mean and spread of the errors in {unit} by displacement, speed and command.",
            ),
        ]
    return Section("Trust", (*blocks, *_group(pictures)))


def parameters(known: Direction) -> Section:
    """Return the section on parameters with their intervals, the map of the valve, the dead zone."""
    metrics, model, mode = known.metrics, known.model, known.mode
    blocks: list[Block] = []
    pictures = []
    trusted = model.uncertainty.get(mode)
    if trusted is not None and trusted.characteristics is not None and "characteristics" in metrics:
        said = [sentence(each) for each in characteristic_sentences(trusted.characteristics, mode)]
        blocks += [Text(" ".join(said)), *characteristic_tables(mode, metrics["characteristics"])]
        pictures.append(
            Picture(
                known.named("speed-map"),
                figures.speed_map(trusted.characteristics),
                "Speed map: steady speed at mid stroke over the command, as the fitted form has it, with its "
                "95 % band; open circles are mean speeds of identification tests while their command stood."
                + (
                    f" One line for each load ({trusted.characteristics.load})."
                    if metrics["characteristics"]["load"]
                    else ""
                ),
                " ".join(said),
            )
        )
    own = [model.adopt(record) for record in known.tests]
    ramps = [model.adopt(record) for record in known.ramps]
    unit = model.units[DISPLACEMENT]
    channel = model.channels[mode]
    pictures.append(
        Picture(
            known.named("valve"),
            figures.valve_map(channel, own, ramps, unit, known.command_unit),
            "Map of the valve: speed over command. Below the dead zone, points show motion dying away.",
            f"Speed in {unit}/s over command in {known.command_unit}: benchmark, tests and ramps.",
        )
    )
    for key, title, name in (
        ("parameters", f"{mode}: parameters of the benchmark", "intervals"),
        ("paper_parameters", f"{mode}: parameters of the paper's transfer function", "paper-intervals"),
    ):
        if key in metrics and metrics[key]["estimates"]:
            blocks.append(parameter_table(title, metrics[key]))
            pictures.append(
                Picture(
                    known.named(name),
                    figures.intervals(metrics[key]),
                    f"{title.partition(': ')[2].capitalize()}: estimate and 95 % interval, each on its own "
                    "scale; the thin line is the bootstrap's. Grey: not determined by the tests.",
                    "; ".join(
                        f"{each['symbol']}: {each['verdict']}" for each in metrics[key]["estimates"].values()
                    ),
                )
            )
    zone = known.trace.get("dead_zone")
    if ramps and zone and zone["value"] > 0:
        pictures.append(
            Picture(
                known.named("dead-zone"),
                figures.dead_zone(ramps, mode, zone["value"], zone["spread"], unit, known.command_unit),
                _dead_zone(zone),
                f"Way of the piston over command on {len(ramps)} ramps; dead zone {zone['value']:.4g} "
                f"{known.command_unit}.",
            )
        )
    return Section("Parameters", (*blocks, *_group(pictures)))


def search(known: Direction) -> Section:
    """Return the section on how the model was found; its trace is in the model's units."""
    trace, unit = known.trace, known.model.units[DISPLACEMENT]
    blocks: list[Block] = []
    pictures = []
    if trace:
        blocks += [Text(sentence(notice)) for notice in trace["notices"]]
        pictures.append(
            Picture(
                known.named("convergence"),
                figures.convergence(trace, unit),
                "Search: best fitness so far, over the tests as the search weighs them, and the parameters "
                "that gave it.",
                "Best RMSE and the parameters that gave it, over the iterations of the search.",
            )
        )
        if trace["phase2"]:
            pictures.append(
                Picture(
                    known.named("losses"),
                    figures.losses(trace),
                    "Training of the compensator; the epoch with the least validation loss is kept.",
                    f"Losses over epochs; that of epoch {trace['phase2']['best_epoch']} is kept.",
                )
            )
        if trace["candidates"]:
            taken = next(each["name"] for each in trace["candidates"] if each["chosen"])
            pictures.append(
                Picture(
                    known.named("structures"),
                    figures.structures(trace["candidates"], unit),
                    "Structures compared in free run, on all tests and on levels held out in turn. A gain "
                    "that grows along the stroke is judged with each test's own speed, so it may be taken "
                    "with a larger error here.",
                    f"RMSE of {len(trace['candidates'])} structures; taken: {taken}.",
                )
            )
    if "searches" in known.metrics:
        blocks.append(search_table(known.mode, known.metrics["searches"], known.unit))
        pictures.append(
            Picture(
                known.named("searches"),
                figures.searches(known.metrics["searches"], known.unit),
                "Searches compared on one budget: the run in the middle, and where each seed ended.",
                f"Best RMSE over the budget for {', '.join(known.metrics['searches'])}.",
            )
        )
    return Section("Search and training", (*blocks, *_group(pictures)))


def _dead_zone(zone: Mapping[str, Any]) -> str:
    """Return where a dead zone comes from, as a caption."""
    if zone["origin"] == "ramps":
        return f"Dead zone from {zone['count']} slow ramps, ± its spread: where they set the piston moving."
    if zone["origin"] == "tests":
        return f"Dead zone from {zone['count']} dynamic tests, ± its standard error; the ramps were not used."
    return "Dead zone as it was given; the ramps were not used."


def _group(pictures: Sequence[Picture]) -> tuple[Pictures, ...]:
    return (Pictures(tuple(pictures)),) if pictures else ()


def _short(value: float | None) -> str:
    return "more than can be told" if value is None else f"{value:.3g}"
