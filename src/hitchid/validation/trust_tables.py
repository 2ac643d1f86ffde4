"""Tables of how far a model can be trusted: parameters, searches, residuals, bands."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hitchid.uncertainty import interval_text, stated
from hitchid.validation.table import Table, digits

PLACES = ("position", "speed", "command")


def trust_tables(mode: str, channel: Mapping[str, Any], unit: str) -> list[Table]:
    """Return the tables of one direction, as far as its figures hold them."""
    found = []
    if "parameters" in channel:
        found.append(parameter_table(f"{mode}: parameters of the benchmark", channel["parameters"]))
    if "characteristics" in channel:
        found += characteristic_tables(mode, channel["characteristics"])
    if "paper_parameters" in channel:
        title = f"{mode}: parameters of the paper's transfer function"
        found.append(parameter_table(title, channel["paper_parameters"]))
    if "bands" in channel:
        found.append(band_table(mode, channel["bands"], unit))
    if "residuals" in channel:
        found.append(residual_table(mode, channel["residuals"], unit))
    if "searches" in channel:
        found.append(search_table(mode, channel["searches"], unit))
    return found


def parameter_table(title: str, known: Mapping[str, Any]) -> Table:
    """Return parameters and what follows from them; what is not determined is given by its interval alone."""
    rows = [
        (
            each["symbol"],
            each["unit"],
            stated(each["value"], each["standard_error"]) if each["determined"] else "",
            interval_text(tuple(each["interval_95"])),
            interval_text(tuple(each["bootstrap_95"])) if each["bootstrap_95"] and each["determined"] else "",
            f"{100 * each['sensitivity']:.3g}",
            each["verdict"],
        )
        for each in known["estimates"].values()
    ]
    rows += [
        (
            name,
            each["unit"],
            f"{each['value']:.4g}" if each["determined"] else "",
            interval_text(tuple(each["interval_95"])),
            "",
            "",
            "determined" if each["determined"] else "not determined",
        )
        for name, each in known["derived"].items()
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


def characteristic_tables(mode: str, known: Mapping[str, Any]) -> list[Table]:
    """Return the speed map of a direction, and its dead zone, delay and response time."""
    unit, speed, load = known["command_unit"], known["speed_unit"], known["load"]
    rows = tuple(
        (
            f"{point['command']:.4g}",
            *([f"{point['load']:.4g}"] if load else []),
            f"{point['speed']:.4g}",
            interval_text((point["lower"], point["upper"])),
            "determined" if point["determined"] else "not determined",
        )
        for point in known["speed_map"]
    )
    header = (f"command / {unit}", *([load] if load else []), f"speed / ({speed})", "95 %", "verdict")
    step = f"step to {known['step_command']:.4g} {unit}"
    named = {
        "dead_zone": ("dead zone", unit),
        "flow_begins": ("command at which flow begins", unit),
        "delay_s": ("delay (5 %)", "s"),
        "response_time_s": ("response time (63 %)", "s"),
    }
    times = tuple(
        (
            name,
            own,
            f"{known[key]['value']:.4g}",
            interval_text((known[key]["lower"], known[key]["upper"])),
            "determined" if known[key]["determined"] else "not determined",
        )
        for key, (name, own) in named.items()
        if known[key] is not None
    )
    return [
        Table(f"{mode}: speed map, at mid stroke", header, rows),
        Table(
            f"{mode}: dead zone, delay, response time ({step})",
            ("quantity", "unit", "value", "95 %", "verdict"),
            times,
        ),
    ]


def band_table(mode: str, bands: Mapping[str, Any], unit: str) -> Table:
    """Return what share of unseen samples the bands cover, in free run and ahead."""
    horizons = bands.get("horizons", {"steps": (), "covered": (), "width": ()})
    rows = [("free run", *_covered(bands["free_run"]["covered"], bands["free_run"]["width"]))]
    rows += [
        (f"{step} sample{'s' if step > 1 else ''} ahead", *_covered(covered, width))
        for step, covered, width in zip(
            horizons["steps"], horizons["covered"], horizons["width"], strict=True
        )
    ]
    level = f"{100 * bands['coverage']:.0f}"
    header = ("prediction", "covered / %", f"mean width / {unit}")
    return Table(f"{mode}: band for {level} % of the samples of an unseen test", header, tuple(rows))


def _covered(share: float, width: float) -> tuple[str, str]:
    return f"{100 * share:.1f}", digits(width)


def residual_table(mode: str, residuals: Mapping[str, Any], unit: str) -> Table:
    """Return what the tests of the errors found, one step ahead and in free run."""
    names = {"one_step": "one step", "free_run": "free run"}
    rows = []
    for run, each in residuals.items():
        if each is None:
            rows.append((names[run], "diverged", *[""] * (len(PLACES) + 4)))
            continue
        worst = max(
            (
                (kind, place)
                for kind in ("position", "speed", "command")
                for place in each[f"by_{kind}"]["bins"]
            ),
            key=lambda pair: pair[1]["rmse"],
        )
        kind, place = worst
        rows.append(
            (
                names[run],
                f"{each['mean']:.3g} ± {each['deviation']:.3g}",
                _yes(each["white"], each["whiteness_p"]),
                _yes(each["independent"], each["independence_p"]),
                _yes(each["normal"], each["normality_p"]),
                *(f"{100 * each[f'by_{name}']['share']:.0f}" for name in PLACES),
                f"{kind} {place['lower']:.3g} … {place['upper']:.3g}: {place['rmse']:.3g}",
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
    return Table(f"{mode}: what the errors show, at 1 %", header, tuple(rows))


def _yes(passed: bool, probability: float) -> str:
    return f"{'yes' if passed else 'no'}, p {'< 0.001' if probability < 1e-3 else f'= {probability:.2g}'}"


def search_table(mode: str, searches: Mapping[str, Any], unit: str) -> Table:
    """Return where several searches ended on one budget, best first."""
    ends = {
        name: np.array([np.inf if end is None else end for end in each["rmse"]])
        for name, each in searches.items()
    }
    best = min(float(rows.min()) for rows in ends.values())
    rows = []
    for name in sorted(ends, key=lambda each: (float(np.median(ends[each])), float(ends[each].max()))):
        each = searches[name]
        rows.append(
            (
                name,
                f"{np.median(ends[name]):.5g}",
                f"{ends[name].max():.5g}",
                f"{100 * (np.median(ends[name]) / best - 1):.2f}",
                f"{np.sum(ends[name] <= 1.01 * best)} of {each['seeds']}",
                f"{np.mean(each['evaluations']):.0f}",
                str(sum(each["failures"])),
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
    return Table(f"{mode}: searches on one budget, before least squares", header, tuple(rows))
