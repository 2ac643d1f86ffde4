"""Position control: every figure of docs/howto/position-control.md against its bar.

    python -m benchmarks.position_control [--draws 20] [--seed 1] [--models DIR] [RIG ...]

Each bench is identified by default from 20 tests per direction, tuned and driven through all scenarios; the
controller of the first is exported as C and holds a plant that no part of hitchid has seen. The boom of
HITCHID_DATA is identified, tuned, and driven as its own model with a load that is 20 % heavier. Models are
kept in DIR and used again. The exit code is 1 where a figure misses its bar.
"""

import argparse
import ctypes
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from benchmarks.free_run import DATA

import hitchid
from hitchid.bench import load_rig
from hitchid.bench.virtual_campaign import write_campaign
from hitchid.control import Drive, ModelPlant, Tuning, load_controller, run_plant_loops, save_controller, tune
from hitchid.control.drive import ON_A, TESTED, drive
from hitchid.control.loops import HEAVIER, DirectionLoops
from hitchid.control.prediction import SPEED_EXPONENT, loads_of_channels
from hitchid.control.scenarios import COMPENSATED
from hitchid.export import to_c
from hitchid.export.verification import find_compiler
from hitchid.logs.record import DIRECTIONS

RIGS = ("nominal", "light-warm-worn", "heavy-cold")
BOOM = "excavator-boom"
MOVED_S, HELD_S, MOVED_MM = 10.0, 60.0, 10.0  # a step before holding, so that it begins where a hitch landed
ROWS = {
    "100 mm up: settled, s": ("steps", "100", "settling_s"),
    "100 mm up: least time, s": ("steps", "100", "t_min_s"),
    "100 mm up: overshoot, mm": ("steps", "100", "overshoot"),
    "100 mm up: final error, mm": ("steps", "100", "final_error"),
    "100 mm down: settled, s": ("steps", "-100", "settling_s"),
    "100 mm down: least time, s": ("steps", "-100", "t_min_s"),
    "100 mm down: overshoot, mm": ("steps", "-100", "overshoot"),
    "100 mm down: final error, mm": ("steps", "-100", "final_error"),
    "5 mm up: settled, s": ("steps", "5", "settling_s"),
    "5 mm down: settled, s": ("steps", "-5", "settling_s"),
    "5 mm up: overshoot, mm": ("steps", "5", "overshoot"),
    "5 mm down: overshoot, mm": ("steps", "-5", "overshoot"),
    "sine 10 mm, 0.1 Hz: RMSE, mm": ("sine", "rmse"),
    "ramps ±8 mm/s: RMSE, mm": ("ramps", "rmse"),
    "`iae_ratio`": ("iae_ratio",),
    "IAE of steps alone over that of SIMC PI": ("iae_ratios", "step"),
}

Line = tuple[str, float, str, float]  # figure, value, "≤" or "≥", bar
WRAPPER = """
#include "lift_controller.h"
static lift_controller_state state;
void start(double displacement) { lift_controller_init(&state, displacement); }
void answer(double target, double measured, double *commands)
{
    lift_controller_input input = { target, measured, 1 };
    lift_controller_output output;
    lift_controller_step(&state, &input, &output);
    commands[0] = output.lifting_current;
    commands[1] = output.lowering_current;
}
"""


class Exported:
    """A controller as C, compiled; one loop at a time."""

    def __init__(self, model: hitchid.Hitch, tuning: Tuning, folder: Path) -> None:
        save_controller(tuning, model, folder / "controller.toml")
        to_c(model, folder / "c", name="lift", controller=load_controller(folder / "controller.toml"))
        (folder / "wrapper.c").write_text(WRAPPER)
        compiler = find_compiler()
        if compiler is None:
            sys.exit("no C compiler is installed")
        sources = [folder / "wrapper.c", folder / "c" / "lift_controller.c"]
        compiler.compile(sources, folder / "lift.so", f"-I{folder / 'c'}", "-shared", "-fPIC")
        self.code = ctypes.CDLL(str(folder / "lift.so"))
        self.commands = (ctypes.c_double * 2)()

    def initial_state(self, displacement: Any) -> None:
        self.code.start(ctypes.c_double(displacement))

    def step(self, state: object, target: Any, measured: Any) -> tuple[None, list[float]]:
        self.code.answer(ctypes.c_double(target), ctypes.c_double(measured), self.commands)
        return None, list(self.commands)


class Unseen:
    """A hitch in mm and A, another than the bench in all its parts.

    40 mA of hysteresis, flow with the power 1.4 of the opening, a lag of 50 ms behind a dead time of 30 ms, a
    leak of 0.03 mm/s, noise of 0.05 mm, dead zones that are 5 % longer than identified.
    """

    def __init__(self, sound: Mapping[str, float]) -> None:
        self.dead_zones = [1.05 * sound[direction] for direction in DIRECTIONS]

    def reset(self, displacement: float, seed: int) -> tuple[dict[str, Any], float]:
        rng = np.random.default_rng(seed)
        state = {"y": displacement, "spool": [0.0, 0.0], "speed": 0.0, "past": [(0.0, 0.0)] * 3, "rng": rng}
        return state, displacement + 0.05 * rng.standard_normal()

    def step(self, state: dict[str, Any], commands: np.ndarray) -> tuple[dict[str, Any], float]:
        state["past"] = [*state["past"][1:], tuple(commands)]
        flows = []
        for number, current in enumerate(state["past"][0]):
            spool = np.clip(state["spool"][number], current - 0.02, current + 0.02)
            state["spool"][number] = spool
            flows.append(max(spool - self.dead_zones[number], 0.0) ** 1.4)
        wanted = 30.0 * flows[0] - 35.0 * flows[1]
        state["speed"] += (1 - np.exp(-0.01 / 0.05)) * (wanted - state["speed"])
        state["y"] += 0.01 * (state["speed"] - 0.03)
        return state, state["y"] + 0.05 * state["rng"].standard_normal()


def model_of(name: str, models: Path, seed: int) -> hitchid.Hitch:
    """Return the model of a bench or of the boom, identified unless it is kept."""
    kept = models / name
    if not kept.exists():
        logs = DATA / BOOM if name == BOOM else models / f"{name}-logs"
        if name != BOOM:
            write_campaign(logs, name, tests={"prbs": 20}, seed=seed)
        hitchid.identify(hitchid.read(logs)).save(kept)
    return hitchid.load(kept)


def bench_lines(name: str, result: Drive) -> Iterator[Line]:
    """Yield the figures of a bench that have a bar."""
    own, rival = result.figures[TESTED], result.figures[COMPENSATED]
    for scenario in result.scenarios.values():
        if scenario.amplitude:
            ratio = own[scenario.name].iae / rival[scenario.name].iae
            yield f"{name}: {scenario.name}: IAE over {COMPENSATED}", ratio, "≤", 1.0
    metrics: Any = result.metrics
    yield f"{name}: valve actions in 10 s of holding", metrics["hold"]["valve_actions_per_10_s"], "≤", 1.0
    yield f"{name}: samples with both valves on", metrics["both_valves_samples"], "≤", 0.0
    yield (
        f"{name}: samples with current, sensor lost",
        metrics["sensor_lost"]["samples_until_closed"],
        "≤",
        0.0,
    )
    yield f"{name}: share of loops inside the predicted band", metrics["band"]["inside"], "≥", 0.85


def unseen_lines(model: hitchid.Hitch, tuning: Tuning, draws: int) -> Iterator[Line]:
    """Yield the figures of exported C that holds a plant nobody has seen, the worst of the loops."""
    plant = Unseen({direction: channel.dead_zone for direction, channel in model.channels.items()})
    middle = 120.0
    target = np.full(round((MOVED_S + HELD_S) / 0.01), middle + MOVED_MM)
    with tempfile.TemporaryDirectory() as folder:
        controller = Exported(model, tuning, Path(folder))
        loops = run_plant_loops(controller, plant, 0, target, start=middle, loops=draws)
    held = slice(-round(HELD_S / 0.01), None)
    on = loops.commands[:, held] > ON_A
    opened = np.diff(on.astype(int), axis=1) > 0
    yield "unseen plant: valve actions in 10 s", 10 / HELD_S * opened.sum(axis=(1, 2)).max(), "≤", 1.0
    valves = [np.nonzero(loop)[1] for loop in opened]  # in the order of time
    reversals = max(int(np.sum(np.diff(own) != 0)) for own in valves)
    yield "unseen plant: reversals in 60 s (a limit cycle has one for each action)", reversals, "≤", 2.0
    error = np.abs(loops.measured[:, held].mean(axis=1) - target[-1]).max()
    yield "unseen plant: mean error, mm", float(error), "≤", 1.0


def boom_lines(models: Path, draws: int, seed: int) -> Iterator[Line]:
    """Yield the figures of the boom: margins with a heavier load, and a drive of its own model."""
    model = model_of(BOOM, models, seed)
    tuning = tune(model)
    ranges = [channel.operating_range.displacement for channel in model.channels.values()]
    travel = min(float(own.lowest) for own in ranges), max(float(own.highest) for own in ranges)
    plant = ModelPlant.of(tuning.controller, model, heavier=HEAVIER, draws=draws)
    result = drive(tuning.controller, plant, travel=travel, units=("deg", "percent"), draws=draws)
    metrics: Any = result.metrics
    yield "boom: samples with both valves on", metrics["both_valves_samples"], "≤", 0.0
    yield "boom: loops that diverged", metrics["diverged"], "≤", 0.0
    factor = (1 + HEAVIER) ** SPEED_EXPONENT
    for number, (direction, row) in enumerate(zip(DIRECTIONS, loads_of_channels(model, None), strict=True)):
        with jax.enable_x64(True):
            loops = DirectionLoops.of(model, direction, row, 200, 0)
            speed = (1 / factor, 1.0)[number]  # the plants of lowering are those of the heavier load
            plants = [each._replace(undelayed=speed * each.undelayed) for each in loops.plants]
            worst = replace(loops, plants=plants).margins(tuning.controller.gains[number]).worst
        yield f"boom, 20 % heavier, {direction}: gain margin, dB", float(worst.gain_db), "≥", 6.0
        yield f"boom, 20 % heavier, {direction}: phase margin, °", float(worst.phase_deg), "≥", 45.0
        yield f"boom, 20 % heavier, {direction}: Ms", float(worst.sensitivity), "≤", 1.7


def value(metrics: Mapping[str, Any], path: tuple[str, ...]) -> str:
    """Return the figure at a path as text."""
    found: Any = metrics
    for name in path:
        found = found[name]
    return "never" if found is None else f"{found:.3g}"


def main() -> None:
    """Print the table of figures, and each figure with a bar beside it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rigs", nargs="*", default=RIGS)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--models", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        models = arguments.models or Path(folder)
        lines: list[Line] = []
        found: dict[str, Mapping[str, Any]] = {}
        for name in arguments.rigs:
            model = model_of(name, models, arguments.seed)
            tuning = tune(model)
            result = drive(tuning.controller, load_rig(name), model=model, draws=arguments.draws)
            found[name] = result.metrics
            lines += bench_lines(name, result)
            if name == arguments.rigs[0]:
                lines += unseen_lines(model, tuning, arguments.draws)
        if (DATA / BOOM).exists():
            lines += boom_lines(models, arguments.draws, arguments.seed)
    table = [["figure", *found], ["---", *["---:"] * len(found)]]
    table += [[title, *(value(metrics, path) for metrics in found.values())] for title, path in ROWS.items()]
    bars = [["figure", "value", "bar", ""], ["---", "---:", "---:", "---"]]
    missed = 0
    for title, figure, sense, bar in lines:
        met = figure <= bar if sense == "≤" else figure >= bar
        missed += not met
        bars.append([title, f"{figure:.4g}", f"{sense} {bar:g}", "met" if met else "MISSED"])
    for rows in (table, bars):
        sys.stdout.writelines(f"| {' | '.join(cells)} |\n" for cells in rows)
        sys.stdout.write("\n")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
