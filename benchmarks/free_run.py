"""Free run on measured data, over seeds: the figures of docs/free_run.md.

    python benchmarks/free_run.py [SET ...] [--seeds 5]
    python benchmarks/free_run.py [SET ...] --rivals

The second form prints every baseline, fitted to the same tests, beside the grey box: medians over the seeds,
and least and greatest of the free run. Sets are folders of HITCHID_DATA: rig-a, excavator-boom,
hanging-load, emps, cascaded-tanks, electro-hydraulic-actuator, and rigs of the virtual bench: nominal,
heavy-cold, light-warm-worn.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from glob import escape
from pathlib import Path

import numpy as np
from scipy.io import loadmat

import hitchid
from hitchid.bench.virtual_campaign import write_campaign
from hitchid.identification import RivalsConfig
from hitchid.identification.preparation import mixed_dead_zones
from hitchid.logs.record import COMMAND, DISPLACEMENT, LIFTING, Record
from hitchid.structures import ModelSpec, structure_named

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
RIVALS = RivalsConfig(trained=True, searches=None)
SHOWN = (1, 10, 100)
KNOWN_TESTS, UNSEEN_TESTS = 20, 40


@dataclass(frozen=True)
class DataSet:
    """One set of data: its campaign, the forms asked for, and the samples an official protocol leaves out."""

    campaign: Callable[[], hitchid.Campaign]
    forms: dict[str, ModelSpec] | None = None
    skipped: int = 0


def single_channel_campaign(
    names: Sequence[str], step_s: float, samples: Sequence[tuple], units: Sequence[str]
) -> hitchid.Campaign:
    """Return a campaign of one channel, its last record held out."""
    records = [
        Record(
            name,
            step_s,
            {COMMAND[LIFTING]: u, DISPLACEMENT: y},
            dict(zip((COMMAND[LIFTING], DISPLACEMENT), units, strict=True)),
        )
        for name, (u, y) in zip(names, samples, strict=True)
    ]
    return hitchid.Campaign.of(records, test_patterns=[names[-1]], kinds={"*": LIFTING})


def emps() -> hitchid.Campaign:
    """Return the positioning system's two records, in mm and V."""
    names = ("DATA_EMPS", "DATA_EMPS_PULSES")
    files = [loadmat(DATA / "emps" / f"{name}.mat") for name in names]
    return single_channel_campaign(
        names, 1e-3, [(f["vir"].ravel(), 1e3 * f["qm"].ravel()) for f in files], ("V", "mm")
    )


def tanks() -> hitchid.Campaign:
    """Return the tanks' two records, in V."""
    table = np.genfromtxt(DATA / "cascaded-tanks" / "dataBenchmark.csv", delimiter=",", names=True)
    names = ("Est", "Val")
    return single_channel_campaign(
        names, 4.0, [(table[f"u{name}"], table[f"y{name}"]) for name in names], ("V", "V")
    )


def hanging_load() -> hitchid.Campaign:
    """Return the strokes of the closed-loop log, the last third of each direction by time held out."""
    campaign = hitchid.read(DATA / "hanging-load")
    segmented = campaign.segmented(
        {direction: zone.value for direction, zone in mixed_dead_zones(campaign).items()}
    )
    test_names = [
        r.name
        for direction in segmented.directions
        for r in segmented.of_kind(direction)[-(-2 * len(segmented.of_kind(direction)) // 3) :]
    ]
    return hitchid.Campaign(segmented.records, tuple(escape(name) for name in test_names))


def virtual_bench(rig: str) -> hitchid.Campaign:
    """Return a campaign of a rig of the virtual bench, tests of another seed held out."""
    with tempfile.TemporaryDirectory() as folder:
        known, unseen = Path(folder) / "known", Path(folder) / "unseen"
        write_campaign(known, rig, tests={"ramp": 3, "prbs": KNOWN_TESTS}, seed=0)
        write_campaign(unseen, rig, tests={"prbs": UNSEEN_TESTS}, seed=7)
        identification, held_out = hitchid.read(known), hitchid.read(unseen)
    left_out = {
        test.name for direction in identification.directions for test in identification.held_out(direction)
    }
    records = [record for record in identification if record.name not in left_out]
    records += [replace(record, name=f"unseen-{record.name}") for record in held_out]
    return hitchid.Campaign(tuple(records), ("unseen-*",))


SETS = {
    "rig-a": DataSet(lambda: hitchid.read(DATA / "rig-a")),
    "excavator-boom": DataSet(lambda: hitchid.read(DATA / "excavator-boom")),
    "hanging-load": DataSet(hanging_load),
    "emps": DataSet(emps, {LIFTING: ModelSpec(structure_named("inertia-with-friction"))}, 20),
    "cascaded-tanks": DataSet(tanks, {LIFTING: ModelSpec(structure_named("cascaded-tanks"))}, 50),
    "electro-hydraulic-actuator": DataSet(lambda: hitchid.read(DATA / "electro-hydraulic-actuator")),
    **{rig: DataSet(partial(virtual_bench, rig)) for rig in ("nominal", "heavy-cold", "light-warm-worn")},
}


def figures(name: str, seed: int) -> dict[str, float]:
    """Identify with one seed; return what is measured on the held-out tests to its value."""
    chosen = SETS[name]
    campaign = chosen.campaign()
    started = time.perf_counter()
    options = {} if chosen.forms is None else {"structure": chosen.forms}
    identification = hitchid.identify(campaign, seed=seed, **options)
    measured = {"identification / s": time.perf_counter() - started}
    if chosen.skipped:
        record = campaign.held_out(LIFTING)[0]
        error = (identification.model.simulate(record).displacement - record.displacement)[chosen.skipped :]
        return measured | {
            f"RMSE / {record.unit}, without {chosen.skipped} samples": float(np.sqrt(np.mean(error**2)))
        }
    metrics = hitchid.validate(identification.model, campaign).metrics
    for direction, channel in metrics["channels"].items():
        r2_values = [test["free_run"]["r2"] for test in channel["per_test"].values()]
        measured |= {
            f"{direction}: free run RMSE / {metrics['unit']}": channel["greybox"]["free_run"]["rmse"],
            f"{direction}: free run R², mean": float(np.mean(r2_values)),
            f"{direction}: free run R², worst": float(np.min(r2_values)),
            f"{direction}: one step RMSE / {metrics['unit']}": channel["greybox"]["one_step"]["rmse"],
            f"{direction}: gate open": float(identification.channels[direction].holdout_test.accepted),
            f"{direction}: channel / s": sum(identification.channels[direction].seconds.values()),
        }
    return measured


def baseline_figures(name: str, seed: int) -> dict[tuple[str, str], list[float]]:
    """Identify with every baseline and one seed; return errors of each direction and model.

    The errors are those 1, 10 and 100 samples ahead and of the free run, then R².
    """
    chosen = SETS[name]
    campaign = chosen.campaign()
    options = {} if chosen.forms is None else {"structure": chosen.forms}
    model = hitchid.identify(campaign, rivals=RIVALS, seed=seed, **options).model
    metrics = hitchid.validate(model, campaign).metrics
    measured = {}
    for direction, channel in metrics["channels"].items():
        horizons = channel["horizons"]
        indices = [horizons["steps"].index(step) for step in SHOWN]
        for rival, runs in {"greybox": channel["greybox"], **channel["baselines"]}.items():
            free = runs.get("free_run", {"rmse": None, "r2": None})
            ahead = [horizons[rival][index] if rival in horizons else None for index in indices]
            values = (*ahead, free["rmse"], free["r2"])
            measured[direction, rival] = [np.nan if value is None else value for value in values]
    return measured


def baseline_rows(name: str, seeds: int) -> list[list[str]]:
    """Return a row a model: medians over seeds, and the range of the free run where it depends on them."""
    trials = [baseline_figures(name, seed) for seed in range(seeds)]
    rows = []
    for direction, model in trials[0]:
        values = np.array([trial[direction, model] for trial in trials if (direction, model) in trial])
        cells = ["-" if np.isnan(value) else f"{value:.3g}" for value in np.median(values, axis=0)]
        least, greatest = (f"{limit:.3g}" for limit in (values[:, 3].min(), values[:, 3].max()))
        if least != greatest:
            cells[3] += f" ({least} to {greatest})"
        rows.append([name, direction, model, *cells])
    return rows


def main() -> None:
    """Print, for each set, every figure's median, least and greatest over the seeds, or every rival."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", default=[], choices=[*SETS, []])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rivals", action="store_true")
    arguments = parser.parse_args()
    names = arguments.sets or list(SETS)
    if arguments.rivals:
        steps = [f"{step} ahead" for step in SHOWN]
        header = ["data", "mode", "model", *steps, "free run", "R²"]
        rows = [
            header,
            ["---"] * len(header),
            *(row for name in names for row in baseline_rows(name, arguments.seeds)),
        ]
        sys.stdout.write("".join(f"| {' | '.join(row)} |\n" for row in rows))
        return
    for name in names:
        trials = [figures(name, seed) for seed in range(arguments.seeds)]
        header = "| figure | median | least | greatest |\n| --- | ---: | ---: | ---: |\n"
        sys.stdout.write(f"\n{name}, {arguments.seeds} seeds\n\n{header}")
        for label in trials[0]:
            values = [trial[label] for trial in trials]
            cells = (np.median(values), min(values), max(values))
            sys.stdout.write(f"| {label} | {' | '.join(f'{value:.5g}' for value in cells)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
