"""The complete study of Sun et al. 2025 on the virtual test bench, in one call."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from hitchid._support.files import write_files, write_folder
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, subtask_progress
from hitchid._support.records import short_repr
from hitchid.bench.sun2025.figures import PaperFigure, paper_figures
from hitchid.bench.sun2025.page import study_report, study_tables, study_tables_document
from hitchid.bench.sun2025.results import DirectionResult, direction_result, mechanistic
from hitchid.bench.virtual_campaign import REPEATS, Protocol, write_campaign
from hitchid.estimation.whale import WhaleConfig
from hitchid.identification import AdamConfig, AutoStructure, CompensatorConfig, Identification, Search, Whale
from hitchid.identification.identify import DEFAULT_STRUCTURES, PAPER_SPECS, TRAINING, WHALE, identify
from hitchid.logs import read
from hitchid.report import FIGURES, Table, read_trace, render, write_report_files
from hitchid.structures import ModelSpec
from hitchid.validation import Validation
from hitchid.validation.validate import validate

LOGS, MODEL, PAPER_MODEL, DATA = "logs", "model", "paper-model", "data"
STUDY_FILE = "study.md"


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
    chosen_plan = plan or Plan()
    report = progress or silent
    studies: list[Study] = []

    def fill(folder: Path) -> None:
        report(ProgressUpdate("virtual bench", 0.0))
        tests: Mapping[Protocol, int] = {
            "ramp": REPEATS,
            "prbs": chosen_plan.tests,
            "cycle": chosen_plan.cycles,
        }
        write_campaign(folder / LOGS, rig, tests=tests, seed=seed)
        campaign = read([folder / LOGS])
        identification = identify(
            campaign,
            structure=chosen_plan.structure,
            search=chosen_plan.search,
            training=chosen_plan.training,
            rivals=chosen_plan.rivals,
            seed=seed,
            progress=subtask_progress(report, 0.1, 0.5),
        )
        paper = identify(
            campaign,
            structure=PAPER_SPECS,
            search=chosen_plan.search,
            # As published: no compensator for free run; the baselines are in the default identification.
            training=replace(chosen_plan.training, free_run=None),
            rivals=None,
            seed=seed,
            progress=subtask_progress(report, 0.6, 0.15),
        )
        identification.save(folder / MODEL)
        paper.save(folder / PAPER_MODEL)
        report(ProgressUpdate("validation", 0.75))
        validation = validate(identification.model, campaign)
        report(ProgressUpdate("figures and tables", 0.9))
        results = {
            direction: direction_result(
                identification, paper, campaign, direction, mechanistic(rig, direction)
            )
            for direction in identification.channels
        }
        unit = campaign.records[0].unit
        trace, paper_trace = read_trace(identification.describe()), read_trace(paper.describe())
        figures = [
            figure
            for direction, result in results.items()
            for figure in paper_figures(direction, trace[direction], paper_trace[direction], result, unit)
        ]
        ordered = tuple(sorted(figures, key=lambda figure: figure.number))
        summary = tuple(study_tables(identification.channels, paper.channels, results, unit))
        studies.append(Study(identification, paper, results, validation, ordered, summary))
        document = study_report(summary, ordered, results, validation, trace=trace, command=command)
        write_report_files(document, folder, data_folder=DATA)
        _write(folder, studies[0])

    write_folder(Path(out), fill, result_kind=STUDY_FILE, force=force)
    return studies[0]


def _write(folder: Path, study: Study) -> None:
    write_files(folder, study.validation.files())
    text = render(study_tables_document(study.tables, study.validation), "markdown").decode()
    pictures = [
        f"## {picture.caption}\n\n![{picture.alt}]({FIGURES}/{picture.name}.svg)\n"
        for figure in study.figures
        for picture in figure.pictures
    ]
    (folder / STUDY_FILE).write_text("\n".join([text, *pictures]), encoding="utf-8")
