"""The complete study of Sun et al. 2025 on the virtual test bench, in one call."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from hitchid._support.files import write_files, write_folder
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, subtask_progress
from hitchid._support.records import short_repr
from hitchid.bench.sun2025.page import study_report, study_tables, study_tables_document
from hitchid.bench.sun2025.results import DirectionResult, direction_result, mechanistic
from hitchid.bench.virtual_campaign import REPEATS, Protocol, write_campaign
from hitchid.estimation import WhaleConfig
from hitchid.identification import (
    DEFAULT_STRUCTURES,
    PAPER_SPECS,
    TRAINING,
    WHALE,
    AdamConfig,
    AutoStructure,
    CompensatorConfig,
    Identification,
    Search,
    Whale,
    identify,
)
from hitchid.logs import LIFTING, LOWERING, read
from hitchid.report import (
    FIGURE_SAMPLES,
    FIGURES,
    ChannelTraceFile,
    Picture,
    Table,
    figures,
    read_trace,
    render,
    write_report_files,
)
from hitchid.structures import ModelSpec
from hitchid.validation import Predictions, Validation, validate

LOGS, MODEL, PAPER_MODEL, DATA = "logs", "model", "paper-model", "data"
STUDY_FILE = "study.md"


# Numbers of the figures in the paper: convergence, predicted errors, their distribution, test set.
NUMBERS = {LIFTING: (5, 7, 9, 11), LOWERING: (6, 8, 10, 12)}
PAPER, DEFAULT = "the paper's method", "hitchid's default"
MODELS = ("mechanistic", "transfer_function", "paper_one_step", "paper", "one_step", "free_run")
DRAWN = ("transfer_function", "paper", "free_run", "one_step")


class PaperFigure(NamedTuple):
    """A reproduced figure of the paper: its number there and its pictures with their data."""

    number: int
    pictures: tuple[Picture, ...]


def paper_figures(
    direction: str, default: ChannelTraceFile, paper: ChannelTraceFile, result: DirectionResult, unit: str
) -> list[PaperFigure]:
    """Return the four figures of one direction in the paper, each for both methods."""
    convergence, predicted, distribution, test_set = NUMBERS[direction]
    methods = ((PAPER, "", paper, result.paper), (DEFAULT, "-default", default, result.default))
    searches = [
        figures.convergence(
            f"figure-{convergence:02d}{suffix}",
            trace.phase1,
            unit,
            f"Figure {convergence} of the paper: convergence of fitness and of each parameter, {direction}, "
            f"{method}.",
            f"Best RMSE and {', '.join(parameter.name for parameter in trace.phase1.parameters)} over the "
            "iterations of the global search.",
        )
        for method, suffix, trace, _ in methods
    ]
    errors = [
        figures.predicted_errors(
            f"figure-{predicted:02d}{suffix}",
            {"training": subsets.training, "validation": subsets.validation},
            unit,
            f"Figure {predicted} of the paper: error of the physics model, actual and predicted one step "
            f"ahead, on training and validation tests, {direction}, {method}.",
            f"Actual and predicted error in {unit} over {FIGURE_SAMPLES} samples.",
        )
        for method, suffix, _, subsets in methods
    ]
    one_step = {
        f"{subset}, {method}": getattr(subsets, subset).errors("one_step")
        for method, subsets in (("paper", result.paper), ("default", result.default))
        for subset in ("training", "validation")
    }
    spread = figures.error_distribution(
        f"figure-{distribution:02d}",
        one_step,
        unit,
        f"Figure {distribution} of the paper: one-step errors of both methods on training and validation "
        f"tests, histogram with fitted normal and cumulative distribution, {direction}.",
        f"Distribution of one-step errors in {unit}.",
    )
    return [
        PaperFigure(convergence, tuple(searches)),
        PaperFigure(predicted, tuple(errors)),
        PaperFigure(distribution, (spread,)),
        PaperFigure(test_set, _test_set(test_set, direction, result.test, unit)),
    ]


def _test_set(number: int, direction: str, test: Predictions, unit: str) -> tuple[Picture, ...]:
    """Return both halves of the figure of the test set."""
    outputs = figures.outputs(
        f"figure-{number:02d}",
        test,
        unit,
        DRAWN,
        f"Figure {number} of the paper, upper half: outputs and errors on the test set, {direction}.",
        f"Displacement and error over time on {len(test.names)} unseen tests.",
        recorded=MODELS,
    )
    errors = figures.error_distribution(
        f"figure-{number:02d}-errors",
        {model: test.errors(model) for model in DRAWN},
        unit,
        f"Figure {number} of the paper, lower half: histogram and cumulative distribution of the errors "
        f"on the test set, {direction}.",
        f"Distribution of the errors in {unit} on {len(test.names)} unseen tests.",
    )
    return outputs, errors


# The whole study.


@dataclass(frozen=True)
class Plan:
    """Extent of the study.

    Attributes:
        tests: number of dynamic tests per direction.
        cycles: number of mixed cycles.
        structure: direction to the form of hitchid's model, by default chosen automatically.
        search, training: settings of both identifications.
        rivals: whether hitchid's model is compared with trained rivals.
    """

    tests: int = 20
    cycles: int = 4
    structure: Mapping[str, ModelSpec | AutoStructure] = field(default_factory=lambda: DEFAULT_STRUCTURES)
    search: Search = WHALE
    training: CompensatorConfig = TRAINING
    rivals: bool = True


def quick_plan() -> Plan:
    """Return a short plan: fewer tests, a smaller search, shorter training, no baselines."""
    optimizer = AdamConfig(epochs=40, patience=20)
    training = CompensatorConfig(hidden=16, adam=optimizer, free_run=None)
    search = Whale(WhaleConfig(iterations=40, evaluations=1200))
    return Plan(tests=8, cycles=1, search=search, training=training, rivals=False)


@short_repr
@dataclass(frozen=True)
class Study:
    """Results of the study.

    Attributes:
        identification: the model identified by default and its traces.
        paper: the model identified by the paper's method and its traces.
        results: direction to predictions of both.
        validation: figures of the default model and its baselines, the paper's method among them.
        figures: the figures of the paper.
        tables: Tables 2 to 4 of the paper and the figures in its text.
    """

    identification: Identification
    paper: Identification
    results: Mapping[str, DirectionResult]
    validation: Validation
    figures: tuple[PaperFigure, ...]
    tables: tuple[Table, ...]


def reproduce(
    out: str | Path,
    *,
    rig: str | Path = "nominal",
    plan: Plan | None = None,
    seed: int = 0,
    force: bool = False,
    progress: ProgressCallback | None = None,
    command: str = "",
) -> Study:
    """Reproduce the study: tests, identification by the paper's method and by default, validation, figures.

    Args:
        out: folder to write: `logs/`, `model/`, `paper-model/`, `report.html` with its `figures/`, `data/`
            (the data of each figure as CSV), `metrics.json`, `tables.md`, `tables/` (each table as CSV) and
            `study.md`.
        rig: parameter set of the virtual test bench.
        plan: extent of the study; by default that of the paper.
        seed: of all random numbers.
        force: replace an older study.
        progress: called with the current task and the completed fraction of the work.
        command: the command line that started the study, for its report.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        SettingsError: the rig's parameters are invalid.
    """
    studies: list[Study] = []

    def fill(folder: Path) -> None:
        studies.append(_study(folder, rig, plan or Plan(), seed, progress or silent, command))

    write_folder(Path(out), fill, result_kind=STUDY_FILE, force=force)
    return studies[0]


def _study(
    folder: Path, rig: str | Path, plan: Plan, seed: int, report: ProgressCallback, command: str
) -> Study:
    report(ProgressUpdate("virtual bench", 0.0))
    tests: Mapping[Protocol, int] = {"ramp": REPEATS, "prbs": plan.tests, "cycle": plan.cycles}
    write_campaign(folder / LOGS, rig, tests=tests, seed=seed)
    campaign = read([folder / LOGS])
    default = identify(
        campaign,
        structure=plan.structure,
        search=plan.search,
        training=plan.training,
        rivals=plan.rivals,
        seed=seed,
        progress=subtask_progress(report, 0.1, 0.5),
    )
    paper = identify(
        campaign,
        structure=PAPER_SPECS,
        search=plan.search,
        # As published: no compensator for free run; the baselines are in the default identification.
        training=replace(plan.training, free_run=None),
        rivals=None,
        seed=seed,
        progress=subtask_progress(report, 0.6, 0.15),
    )
    default.save(folder / MODEL)
    paper.save(folder / PAPER_MODEL)
    report(ProgressUpdate("validation", 0.75))
    validation = validate(default.model, campaign)
    report(ProgressUpdate("figures and tables", 0.9))
    results = {
        direction: direction_result(default, paper, campaign, direction, mechanistic(rig, direction))
        for direction in default.channels
    }
    unit = campaign.records[0].unit
    trace, paper_trace = read_trace(default.describe()), read_trace(paper.describe())
    unordered = [
        figure
        for direction, result in results.items()
        for figure in paper_figures(direction, trace[direction], paper_trace[direction], result, unit)
    ]
    ordered = tuple(sorted(unordered, key=lambda figure: figure.number))
    tables = tuple(study_tables(default.channels, paper.channels, results, unit))
    pictures = tuple(picture for figure in ordered for picture in figure.pictures)
    document = study_report(tables, pictures, results, validation, trace=trace, command=command)
    write_report_files(document, folder, data_folder=DATA)
    write_files(folder, validation.files())
    text = render(study_tables_document(tables, validation), "markdown").decode()
    shown = [
        f"## {picture.caption}\n\n![{picture.alt}]({FIGURES}/{picture.name}.svg)\n" for picture in pictures
    ]
    (folder / STUDY_FILE).write_text("\n".join([text, *shown]), encoding="utf-8")
    return Study(default, paper, results, validation, ordered, tables)
