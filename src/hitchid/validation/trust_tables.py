"""Tables of how far a model can be trusted: parameters, searches, residuals, bands."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hitchid.uncertainty import format_interval, format_with_error
from hitchid.validation.table import Table, digits

BIN_QUANTITIES = ("position", "speed", "command")


def trust_tables(direction: str, channel: Mapping[str, Any], unit: str) -> list[Table]:
    """Return the tables of one direction, as far as its figures hold them."""
    all_tables = []
    if "parameters" in channel:
        all_tables.append(parameter_table(f"{direction}: parameters of the benchmark", channel["parameters"]))
    if "characteristics" in channel:
        all_tables += characteristic_tables(direction, channel["characteristics"])
    if "paper_parameters" in channel:
        title = f"{direction}: parameters of the paper's transfer function"
        all_tables.append(parameter_table(title, channel["paper_parameters"]))
    if "bands" in channel:
        all_tables.append(band_table(direction, channel["bands"], unit))
    if "residuals" in channel:
        all_tables.append(residual_table(direction, channel["residuals"], unit))
    if "searches" in channel:
        all_tables.append(search_table(direction, channel["searches"], unit))
    return all_tables


def parameter_table(title: str, parameters: Mapping[str, Any]) -> Table:
    """Return parameters and what follows from them; what is not determined is given by its interval alone."""
    rows = [
        (
            estimate["symbol"],
            estimate["unit"],
            format_with_error(estimate["value"], estimate["standard_error"])
            if estimate["determined"]
            else "",
            format_interval(tuple(estimate["interval_95"])),
            format_interval(tuple(estimate["bootstrap_95"]))
            if estimate["bootstrap_95"] and estimate["determined"]
            else "",
            f"{100 * estimate['sensitivity']:.3g}",
            estimate["verdict"],
        )
        for estimate in parameters["estimates"].values()
    ]
    rows += [
        (
            name,
            quantity["unit"],
            f"{quantity['value']:.4g}" if quantity["determined"] else "",
            format_interval(tuple(quantity["interval_95"])),
            "",
            "",
            "determined" if quantity["determined"] else "not determined",
        )
        for name, quantity in parameters["derived"].items()
    ]
    header = (
        "parameter",
        "unit",
        "value ± standard error",
        "95 %",
        "bootstrap",
        "RMSE for ±1 % / %",
        "verdict",
    )
    return Table(title, header, tuple(rows))


def characteristic_tables(direction: str, characteristics: Mapping[str, Any]) -> list[Table]:
    """Return the speed map of a direction, and its dead zone, delay and response time."""
    unit, speed, load = (
        characteristics["command_unit"],
        characteristics["speed_unit"],
        characteristics["load"],
    )
    rows = tuple(
        (
            f"{point['command']:.4g}",
            *([f"{point['load']:.4g}"] if load else []),
            f"{point['speed']:.4g}",
            format_interval((point["lower"], point["upper"])),
            "determined" if point["determined"] else "not determined",
        )
        for point in characteristics["speed_map"]
    )
    header = (f"command / {unit}", *([load] if load else []), f"speed / ({speed})", "95 %", "verdict")
    step = f"step to {characteristics['step_command']:.4g} {unit}"
    labels = {
        "dead_zone": ("dead zone", unit),
        "flow_begins": ("command at which flow begins", unit),
        "delay_s": ("delay (5 %)", "s"),
        "response_time_s": ("response time (63 %)", "s"),
    }
    quantity_rows = tuple(
        (
            name,
            quantity_unit,
            f"{characteristics[key]['value']:.4g}",
            format_interval((characteristics[key]["lower"], characteristics[key]["upper"])),
            "determined" if characteristics[key]["determined"] else "not determined",
        )
        for key, (name, quantity_unit) in labels.items()
        if characteristics[key] is not None
    )
    return [
        Table(f"{direction}: speed map, at mid stroke", header, rows),
        Table(
            f"{direction}: dead zone, delay, response time ({step})",
            ("quantity", "unit", "value", "95 %", "verdict"),
            quantity_rows,
        ),
    ]


def band_table(direction: str, bands: Mapping[str, Any], unit: str) -> Table:
    """Return what share of unseen samples the bands cover, in free run and ahead."""
    horizons = bands.get("horizons", {"steps": (), "covered": (), "width": ()})
    rows = [("free run", *_coverage_cells(bands["free_run"]["covered"], bands["free_run"]["width"]))]
    rows += [
        (f"{step} sample{'s' if step > 1 else ''} ahead", *_coverage_cells(covered, width))
        for step, covered, width in zip(
            horizons["steps"], horizons["covered"], horizons["width"], strict=True
        )
    ]
    level = f"{100 * bands['coverage']:.0f}"
    header = ("prediction", "covered / %", f"mean width / {unit}")
    return Table(f"{direction}: band for {level} % of the samples of an unseen test", header, tuple(rows))


def _coverage_cells(share: float, width: float) -> tuple[str, str]:
    return f"{100 * share:.1f}", digits(width)


def residual_table(direction: str, residuals: Mapping[str, Any], unit: str) -> Table:
    """Return what the tests of the errors found, one step ahead and in free run."""
    names = {"one_step": "one step", "free_run": "free run"}
    rows = []
    for run, findings in residuals.items():
        if findings is None:
            rows.append((names[run], "diverged", *[""] * (len(BIN_QUANTITIES) + 4)))
            continue
        worst = max(
            (
                (kind, error_bin)
                for kind in ("position", "speed", "command")
                for error_bin in findings[f"by_{kind}"]["bins"]
            ),
            key=lambda pair: pair[1]["rmse"],
        )
        kind, error_bin = worst
        rows.append(
            (
                names[run],
                f"{findings['mean']:.3g} ± {findings['deviation']:.3g}",
                _decision_text(findings["white"], findings["whiteness_p"]),
                _decision_text(findings["independent"], findings["independence_p"]),
                _decision_text(findings["normal"], findings["normality_p"]),
                *(f"{100 * findings[f'by_{name}']['share']:.0f}" for name in BIN_QUANTITIES),
                f"{kind} {error_bin['lower']:.3g} … {error_bin['upper']:.3g}: {error_bin['rmse']:.3g}",
            )
        )
    header = (
        "errors",
        f"mean ± std / {unit}",
        "white",
        "independent of the command",
        "normal",
        "explained by position / %",
        "by speed / %",
        "by command / %",
        f"largest RMSE / {unit}",
    )
    return Table(f"{direction}: what the errors show, at 1 %", header, tuple(rows))


def _decision_text(passed: bool, probability: float) -> str:
    return f"{'yes' if passed else 'no'}, p {'< 0.001' if probability < 1e-3 else f'= {probability:.2g}'}"


def search_table(direction: str, searches: Mapping[str, Any], unit: str) -> Table:
    """Return where several searches ended on one budget, best first."""
    ends = {
        name: np.array([np.inf if end is None else end for end in search["rmse"]])
        for name, search in searches.items()
    }
    best = min(float(rows.min()) for rows in ends.values())
    rows = []
    for name in sorted(ends, key=lambda entry: (float(np.median(ends[entry])), float(ends[entry].max()))):
        search = searches[name]
        rows.append(
            (
                name,
                f"{np.median(ends[name]):.5g}",
                f"{ends[name].max():.5g}",
                f"{100 * (np.median(ends[name]) / best - 1):.2f}",
                f"{np.sum(ends[name] <= 1.01 * best)} of {search['seeds']}",
                f"{np.mean(search['evaluations']):.0f}",
                str(sum(search["failures"])),
            )
        )
    header = (
        "search, best first",
        f"median RMSE / {unit}",
        f"worst seed / {unit}",
        "median above the best / %",
        "seeds within 1 % of the best",
        "evaluations",
        "failed",
    )
    return Table(f"{direction}: searches on one budget, before least squares", header, tuple(rows))
