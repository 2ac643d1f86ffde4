"""Tables 2 to 4 of the paper with our values, and the figures in its text."""

from collections.abc import Mapping, Sequence

import numpy as np

from hitchid._support import numbers
from hitchid.bench.sun2025.results import DirectionResult, ErrorSummary, end_deviation, summary
from hitchid.identification import ChannelTrace
from hitchid.logs import LIFTING, LOWERING
from hitchid.model import Estimate, Quantity
from hitchid.report import (
    ChannelTraceFile,
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    accuracy_section,
    all_tables,
    direction_sections,
    logs_section,
    origin_section,
    parameters_section,
    sentence,
    trust_section,
    verdict_section,
)
from hitchid.validation import Validation

# Report of the study: tables and figures of the paper with our values, and our uncertainty.

PREFACE = (
    "Sun et al. 2025 (Processes 13, 3608) measured on their own test bench; these "
    "tests were simulated on the virtual bench. The tables show both values; a "
    "difference does not rank the methods. Both methods were identified from the same tests: the paper's as "
    "published, and hitchid's default, which chooses the form of the physics model."
)


def study_report(
    tables: Sequence[Table],
    pictures: tuple[Picture, ...],
    results: Mapping[str, DirectionResult],
    result: Validation,
    *,
    trace: Mapping[str, ChannelTraceFile],
    command: str,
) -> Document:
    """Return the report of the study: tables, figures, and the validation of hitchid's default model."""
    data = result.report_data()
    section_builders = (accuracy_section, trust_section, parameters_section)
    return Document(
        title="The study of Sun et al. 2025, redone",
        subtitle="Lifting and lowering of an electro-hydraulic hitch on the virtual bench",
        verdict=(
            *(_default_finding(direction, own, result.unit) for direction, own in results.items()),
            *verdict_section(result, None),
        ),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            ReportSection("Tables of the paper", (Text(PREFACE), *tables)),
            ReportSection("Figures of the paper", (Pictures(pictures),)),
            *direction_sections(result, data, trace, section_builders),
            logs_section(data.logs),
            origin_section(data.origin, command),
        ),
        summary=tuple(tables),
        data=result.metrics,
    )


def _default_finding(direction: str, result: DirectionResult, unit: str) -> Finding:
    """Return the free run of the default beside that of the paper's method; good if significantly better."""
    texts = {}
    for model in ("free_run", "paper", "transfer_function"):
        figures = summary(result.test, model)
        texts[model] = numbers.with_error(figures.rmse, figures.rmse_error)
    text = (
        f"{direction.capitalize()}, hitchid's default, free run: RMSE {texts['free_run']} {unit} on "
        f"{numbers.count(len(result.test.names), 'unseen test')}; the paper's method on its own predictions "
        f"{texts['paper']}, its transfer function {texts['transfer_function']}"
    )
    rivals = ("paper", "transfer_function")
    if all(result.test.is_significantly_better("free_run", model) for model in rivals):
        return Finding(Rating.GOOD, f"{text}: significantly better than both.")
    return Finding(Rating.CAUTION, f"{text}: not significantly better than both.")


def study_tables_document(tables: Sequence[Table], result: Validation) -> Document:
    """Return the tables of the paper and of the validation, the content of `study.md`."""
    section = ReportSection("", (*tables, *all_tables(result)))
    return Document(title="Study", notices=result.notices, sections=(section,), data=result.metrics)


# Values printed by Sun et al. 2025; errors in mm, currents in A.
PAPER_COEFFICIENTS = {
    LIFTING: {"alpha1": 6.625, "beta1": 0.001, "beta2": 0.065, "beta3": 0.318},
    LOWERING: {"alpha2": 654.473, "beta4": 42.808},
}
ALPHA1, BETA1, BETA2, BETA3 = PAPER_COEFFICIENTS[LIFTING].values()
ALPHA2, BETA4 = PAPER_COEFFICIENTS[LOWERING].values()
FREQUENCY = float(np.sqrt(BETA3 / BETA1))
# Our parameters of the same transfer functions, with their units.
PAPER_PARAMETERS = {
    LIFTING: {
        "gain": (ALPHA1 / BETA3, "mm/(s·A)"),
        "natural_frequency": (FREQUENCY, "rad/s"),
        "damping_ratio": (BETA2 / BETA3 * FREQUENCY / 2, "1"),
    },
    LOWERING: {"gain": (ALPHA2 / BETA4, "mm/(s·A)"), "time_constant": (BETA4, "s")},
}
PAPER_TEST = {
    LIFTING: {
        "transfer_function": ErrorSummary(rmse=0.79, mae=0.59, r2=0.9881, within_1=0.79, mean=0.42, std=0.66),
        "paper_one_step": ErrorSummary(rmse=0.33, mae=0.24, r2=0.9986, within_1=0.98, mean=0.21, std=0.24),
    },
    LOWERING: {
        "transfer_function": ErrorSummary(rmse=3.79, mae=3.33, r2=0.9606, within_1=0.15, mean=3.06, std=2.24),
        "paper_one_step": ErrorSummary(rmse=0.48, mae=0.40, r2=0.9963, within_1=0.97, mean=0.30, std=0.38),
    },
}
PAPER_FITNESS = {LIFTING: 1.142, LOWERING: 1.611}
PAPER_COMPENSATOR = {
    LIFTING: {"training": (0.127, 0.101), "validation": (0.138, 0.110), "p95": 0.30},
    LOWERING: {"training": (0.147, 0.117), "validation": (0.160, 0.125), "p95": 0.35},
}
TABLE_OF = {LIFTING: 3, LOWERING: 4}
PAPER_MECHANISTIC = {LIFTING: "", LOWERING: "12.5 (the paper does not say of which quantity)"}
MODELS = {
    "mechanistic": "mechanistic, free run",
    "transfer_function": "paper's transfer function, free run",
    "paper": "paper's method on its own predictions, free run",
    "free_run": "hitchid's default, free run",
    "paper_one_step": "paper's method, one step",
    "one_step": "hitchid's default, one step",
}
Traces = Mapping[str, ChannelTrace]


def study_tables(
    default: Traces, paper: Traces, results: Mapping[str, DirectionResult], unit: str
) -> list[Table]:
    """Return Tables 3, 4 and 2 of the paper, and those of fitness, compensator, mechanics, sensitivity."""
    return [
        *(_test_set(direction, result, unit) for direction, result in results.items()),
        _parameters(paper),
        _default_parameters(default),
        _identification(default, paper, results, unit),
        _mechanistic(paper, results, unit),
        _sensitivity(paper, "the paper's transfer functions"),
        _sensitivity(default, "hitchid's default models"),
    ]


def _default_parameters(traces: Traces) -> Table:
    """Return the parameters of the models identified by default, whose form the paper does not have."""
    rows = tuple(
        (
            _label(direction, estimate),
            numbers.with_unit(_value_or_interval(estimate), estimate.unit),
            numbers.interval(estimate.interval),
            estimate.verdict,
        )
        for direction, trace in traces.items()
        for estimate in trace.phase1.parameter_estimates
    )
    header = ("parameter", "estimate", "95 % interval", "verdict")
    return Table("Parameters of hitchid's default models", header, rows)


def _label(direction: str, estimate: Estimate) -> str:
    return f"{direction}: {estimate.name.replace('_', ' ')}"


def _parameters(traces: Traces) -> Table:
    """Return the parameters of both transfer functions (paper, Table 2)."""
    rows = []
    for direction, trace in traces.items():
        for estimate in trace.phase1.parameter_estimates:
            value = numbers.with_unit(_value_or_interval(estimate), estimate.unit)
            published = PAPER_PARAMETERS[direction].get(estimate.name)
            theirs = numbers.with_unit(f"{published[0]:.4g}", published[1]) if published else ""
            rows.append((_label(direction, estimate), value, theirs, estimate.verdict))
        for name, (value, unit) in _coefficients(direction, trace).items():
            theirs = f"{PAPER_COEFFICIENTS[direction][name]:.4g}"
            rows.append((f"{direction}: {name}", numbers.with_unit(value, unit), theirs, ""))
    header = ("parameter", "here", "paper", "verdict")
    return Table("Table 2. Parameters of the transfer functions", header, tuple(rows))


def _coefficients(direction: str, trace: ChannelTrace) -> dict[str, tuple[str, str]]:
    """Return the paper's α and β for one direction, with the free common scale of lifting set by its β₃."""
    quantities = {quantity.name: quantity for quantity in trace.phase1.assessment.derived}
    if direction == LOWERING:
        shown, fixed = {"alpha2": quantities["alpha2 = K"], "beta4": quantities["beta4 = tau"]}, {}
    else:
        # Only ratios are determined: at the paper's β₃ the others can be set beside the paper's.
        names = ("alpha1", "beta1", "beta2")
        shown = {name: quantities[f"{name} (beta3 = 1)"].scaled(BETA3) for name in names}
        fixed = {"beta3": (f"{BETA3:.4g}", "as the paper has it")}
    return {name: (_value_or_interval(own), own.unit) for name, own in shown.items()} | fixed


def _value_or_interval(estimate: Estimate | Quantity) -> str:
    """Return a value, or the interval if it is not determined."""
    return f"{estimate.value:.4g}" if estimate.determined else numbers.interval(estimate.interval)


def _test_set(direction: str, result: DirectionResult, unit: str) -> Table:
    rows = []
    for model, label in MODELS.items():
        ours, theirs = summary(result.test, model), PAPER_TEST[direction].get(model)
        rows.append((f"{label}, here", *_row(ours)))
        if theirs is not None:
            rows.append((f"{label}, paper", *_row(theirs)))
    # What one step ahead is worth: the error of saying that the piston stays where it was measured.
    persistence = np.concatenate([np.diff(actual) for actual in result.test.actual])
    rows.append(
        (
            "persistence, one step, here",
            f"{np.sqrt(np.mean(persistence**2)):.3g}",
            f"{np.mean(np.abs(persistence)):.3g}",
            "",
            numbers.percent(float(np.mean(np.abs(persistence) < 1))),
            f"{persistence.mean():.2f} ± {persistence.std():.2f}",
        )
    )
    header = ("model", f"RMSE / {unit}", f"MAE / {unit}", "R²", f"below 1 {unit} / %", f"mean ± std / {unit}")
    return Table(f"Table {TABLE_OF[direction]}. Test set, {direction}", header, tuple(rows))


def _row(figures: ErrorSummary) -> tuple[str, ...]:
    return (
        numbers.with_error(figures.rmse, figures.rmse_error),
        numbers.rounded(figures.mae, figures.rmse_error),
        f"{figures.r2:.4f}",
        numbers.percent(figures.within_1),
        f"{figures.mean:.2f} ± {figures.std:.2f}",
    )


def _identification(
    default: Traces, paper: Traces, results: Mapping[str, DirectionResult], unit: str
) -> Table:
    """Return the errors of phases 1 and 2 of both methods beside the paper's."""
    rows = []
    for direction, result in results.items():
        traces, methods = (default[direction], paper[direction]), (result.default, result.paper)
        published = PAPER_COMPENSATOR[direction]
        phase1 = [f"{trace.phase1.rmse:.3f}" for trace in traces]
        fitness = [trace.phase1.fit.search_result.fitness_trace for trace in traces]
        iterations = [str(int(np.flatnonzero(own <= 1.01 * own[-1])[0]) + 1) for own in fitness]
        most = "at most 15" if direction == LIFTING else "at most 10"
        rows += [
            (f"{direction}: phase 1, RMSE", *phase1, f"{PAPER_FITNESS[direction]:.3f}"),
            (f"{direction}: iterations to within 1 % of the end", *iterations, most),
        ]
        for subset in ("training", "validation"):
            figures = [summary(getattr(method, subset), "one_step") for method in methods]
            rmse, mae = published[subset]
            name = f"{direction}: compensator one step ahead, {subset}"
            rows.append((f"{name}, RMSE", *(f"{figure.rmse:.3f}" for figure in figures), f"{rmse:.3f}"))
            rows.append((f"{name}, MAE", *(f"{figure.mae:.3f}" for figure in figures), f"{mae:.3f}"))
        quantiles = [np.quantile(np.abs(method.validation.errors("one_step")), 0.95) for method in methods]
        cells = (*(f"{quantile:.3f}" for quantile in quantiles), f"{published['p95']:.2f}")
        rows.append((f"{direction}: 95 % of errors below", *cells))
    header = ("figure", "hitchid's default", "paper's method, here", "paper")
    return Table(f"Identification, errors in {unit}", header, tuple(rows))


def _mechanistic(traces: Traces, results: Mapping[str, DirectionResult], unit: str) -> Table:
    """Return parameters from data sheets and from tests, and the deviation in the paper's discussion."""
    rows = []
    for direction, trace in traces.items():
        (physical_model, dead_zone), test = results[direction].mechanistic, results[direction].test
        units = {p.name: p.unit.format(x=unit, u="A") for p in physical_model.structure.parameters}
        fitted = {estimate.name: estimate.value for estimate in trace.phase1.parameter_estimates}
        rows.append(
            (f"{direction}: dead zone / A", f"{dead_zone:.4g}", f"{trace.dead_zone.value:.4g}", "", "")
        )
        for name, value in physical_model.named_values().items():
            estimate = f"{fitted[name]:.4g}" if name in fitted else ""
            label = f"{direction}: {name.replace('_', ' ')} / {units[name]}"
            rows.append((label, f"{value:.4g}", estimate, "", ""))
        models = ("mechanistic", "transfer_function", "free_run")
        ends = [f"{100 * end_deviation(test, model):.1f}" for model in models]
        label = f"{direction}: error at the end of a test / % of the travel"
        rows.append((label, *ends, PAPER_MECHANISTIC[direction]))
    header = ("figure", "data sheets", "paper's transfer function", "hitchid's default", "paper's ref. 9")
    return Table("Mechanistic model from data sheets, nothing fitted", header, tuple(rows))


def _sensitivity(traces: Traces, models: str) -> Table:
    rows = tuple(
        (_label(direction, estimate), f"{100 * estimate.sensitivity:.2f}")
        for direction, trace in traces.items()
        for estimate in trace.phase1.parameter_estimates
    )
    return Table(f"Sensitivity of {models}: change of RMSE for ±1 % of a parameter", ("parameter", "%"), rows)
