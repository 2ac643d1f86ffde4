"""The whole study of Sun et al. 2025 on the virtual bench, in one call."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hitchid._support.progress import Progress, Step, part, silent
from hitchid._support.storage import put, write_folder
from hitchid.estimation import Comparison
from hitchid.estimation.whale import Swarm
from hitchid.experiments.virtual_campaign import REPEATS, Protocol, write_campaign
from hitchid.identification import Descent, Identification, Search, Training, Whale, identify
from hitchid.identification.identify import COMPARISON, PAPER_FORMS, TRAINING, WHALE
from hitchid.readers import read, write_table
from hitchid.report import FIGURES, put_report
from hitchid.studies.sun2025.document import study_report
from hitchid.studies.sun2025.figures import Drawn, paper_figures
from hitchid.studies.sun2025.mechanistic import mechanistic
from hitchid.studies.sun2025.results import DirectionResult, direction_result
from hitchid.studies.sun2025.tables import study_tables
from hitchid.validation import Table, Validation, markdown, tables, validate

LOGS, MODEL, DATA = "logs", "model", "data"
STUDY_FILE = "study.md"


@dataclass(frozen=True)
class Plan:
    """How much of the study is done.

    Attributes:
        tests: dynamic tests a direction.
        cycles: mixed cycles.
        search, training, comparison: of the identification.
    """

    tests: int = 20
    cycles: int = 4
    search: Search = WHALE
    training: Training = TRAINING
    comparison: Comparison | None = COMPARISON


def quick_plan() -> Plan:
    """Return a plan for a first look: fewer tests, a smaller search, shorter training, no baselines."""
    descent = Descent(epochs=40, patience=20)
    training = Training(hidden=16, descent=descent, rollouts=None, baselines=False)
    search = Whale(Swarm(iterations=40, evaluations=1200))
    return Plan(tests=8, cycles=1, search=search, training=training, comparison=None)


@dataclass(frozen=True)
class Study:
    """Everything the study found.

    Attributes:
        found: the identified model and its traces.
        results: mode to predictions.
        validation: all figures beside their baselines.
        drawn: the figures of the paper.
        tables: Tables 2 to 4 of the paper and what its text names.
    """

    found: Identification
    results: Mapping[str, DirectionResult]
    validation: Validation
    drawn: tuple[Drawn, ...]
    tables: tuple[Table, ...]


def reproduce(
    out: str | Path,
    *,
    rig: str | Path = "nominal",
    plan: Plan | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress | None = None,
    command: str = "",
) -> Study:
    """Redo the study: static tests, dynamic tests, identification, validation, tables and figures.

    Args:
        out: folder to write: `logs/`, `model/`, `report.html` with its `figures/`, `data/` (CSV behind each
            figure of the paper), `metrics.json`, `tables.md` and `study.md`.
        rig: parameter set of the virtual bench.
        plan: how much is done; all of the paper's programme by default.
        seed: every random draw comes from it.
        force: replace an older study.
        progress: called with what is being done and the fraction of all work that is done.
        command: that asked for the study, for its report.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        SettingsError: the rig's parameters cannot be used.
    """
    asked = plan or Plan()
    report = progress or silent
    kept: list[Study] = []

    def fill(place: Path) -> None:
        report(Step("virtual bench", 0.0))
        tests: Mapping[Protocol, int] = {"ramp": REPEATS, "prbs": asked.tests, "cycle": asked.cycles}
        write_campaign(place / LOGS, rig, tests=tests, seed=seed)
        campaign = read([place / LOGS])
        found = identify(
            campaign,
            structure=PAPER_FORMS,
            search=asked.search,
            training=asked.training,
            comparison=asked.comparison,
            seed=seed,
            progress=part(report, 0.15, 0.6),
        )
        found.save(place / MODEL)
        report(Step("validation", 0.75))
        checked = validate(found.model, campaign)
        report(Step("figures and tables", 0.9))
        results = {
            mode: direction_result(found, campaign, mode, mechanistic(rig, mode)) for mode in found.channels
        }
        unit = campaign.records[0].unit
        trace = found.describe()
        drawn = [each for mode in results for each in paper_figures(mode, trace[mode], results[mode], unit)]
        ordered = tuple(sorted(drawn, key=lambda each: each.number))
        summary = tuple(study_tables(found.channels, results, unit))
        kept.append(Study(found, results, checked, ordered, summary))
        document = study_report(
            summary, ordered, checked, found.model, campaign, trace=trace, command=command
        )
        put_report(document, place)
        _write(place, kept[0])

    write_folder(Path(out), fill, mark=STUDY_FILE, force=force)
    return kept[0]


def _write(place: Path, study: Study) -> None:
    (place / DATA).mkdir()
    for each in study.drawn:
        write_table(place / DATA / f"figure-{each.number:02d}.csv", _equal_lengths(each.data))
    put(place, study.validation.files())
    text = markdown(
        (*study.tables, *tables(study.validation.metrics)), study.validation.notices, title="Study"
    )
    pictures = [
        f"## {picture.caption}\n\n![{picture.alt}]({FIGURES}/{picture.name}.svg)\n"
        for each in study.drawn
        for picture in each.pictures
    ]
    (place / STUDY_FILE).write_text("\n".join([text, *pictures]), encoding="utf-8")


def _equal_lengths(data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return columns padded with NaN to the longest, so that one file holds them."""
    longest = max(column.size for column in data.values())
    return {
        name: np.pad(column.astype(float), (0, longest - column.size), constant_values=np.nan)
        for name, column in data.items()
    }
