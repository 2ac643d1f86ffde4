"""Campaigns that choose their own tests beside the fixed programme and random tests, on drawn machines.

    python -m benchmarks.campaign [MACHINES] [--physics]

Each machine is a virtual bench of one of three parameter sets, whose load, oil and valves are scattered by
10 %. The fixed programme, 3 + 3 ramps and 20 + 20 tests of 10 s with the moves between them, is run by the
same loop. All models are judged by free run on 40 tests that none has seen.
"""

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

import hitchid
from hitchid._support.jax_setup import prepare_jax
from hitchid._support.precision import double_precision
from hitchid.bench import Rig, load_rig
from hitchid.bench.excitation import two_channel_command
from hitchid.bench.virtual_campaign import run
from hitchid.hmi.adaptive import guarded
from hitchid.hmi.bench_loop import BenchLoop
from hitchid.hmi.campaign_files import SETTINGS, CampaignFiles
from hitchid.hmi.headless import campaign
from hitchid.hmi.plans import limits_of_rig
from hitchid.hmi.programs import Machine, Step, move
from hitchid.hmi.safety import State
from hitchid.hmi.sources.simulated import VirtualBench
from hitchid.identification.settings_file import read_settings
from hitchid.logs import DIRECTIONS, write_table

SETS = ("nominal", "heavy-cold", "light-warm-worn")
SCATTER = 0.1  # standard deviation of the logarithms of load, oil viscosity and valves
SHARES = (0.25, 0.5)  # of the bench time of the fixed programme
COLUMNS = """[signals]
time = "time_s"
lifting_command = { column = "current_up_A", unit = "A" }
lowering_command = { column = "current_down_A", unit = "A" }
displacement = { column = "displacement_mm", unit = "mm" }
"""


@double_precision
def drawn_machine(number: int) -> Rig:
    """Return the machine of a number: parameter sets in turn, load, oil and valves scattered."""
    rig, rng = load_rig(SETS[number % len(SETS)]), np.random.default_rng([50, number])

    def places(rig: Rig) -> list[jax.Array]:
        valves = (rig.lifting_valve.spool, rig.lowering_valve.spool)
        areas = [value for valve in valves for value in (valve.dead_zone, valve.full_area, valve.hysteresis)]
        return [rig.linkage.implement_mass, *areas]

    values = [value * float(np.exp(SCATTER * rng.standard_normal())) for value in places(rig)]
    changed = eqx.tree_at(places, rig, values)
    # Ten percent of the viscosity are some three kelvins.
    warmer = changed.oil.temperature + 3.0 * float(rng.standard_normal())
    return eqx.tree_at(lambda rig: rig.oil.temperature, changed, warmer)


class Watched(VirtualBench):
    """A virtual bench that counts what must never happen."""

    def __init__(self, rig: Rig, seed: int) -> None:
        super().__init__(rig, seed)
        self.limits = limits_of_rig(rig)
        self.stops = self.both = self.beyond = 0
        self.seconds = 0.0

    def write(self, commands: np.ndarray) -> None:
        """Advance the bench, and count commands and displacements that are wrong."""
        super().write(commands)
        self.seconds += self.step_s
        at_mm = 1e3 * float(self._state.plant.displacement)
        low, high = self.limits.displacement
        self.stops += bool(np.any(commands > 0)) and not low + 0.1 < at_mm < high - 0.1 and self.seconds > 30
        self.both += bool(np.all(commands > 0))
        self.beyond += bool(np.any(commands > np.array(self.limits.commands) + 1e-9))


def fixed_programme(rig: Rig, folder: Path, seed: int, tests: int = 20) -> tuple[Path, float]:
    """Run the fixed programme; return the folder of its logs and its bench time, s."""
    source = Watched(rig, seed)
    loop = BenchLoop(folder, limits_file=source.limits, make=lambda _: source)
    plan = {"kind": "campaign", "name": "fixed", "ramps": 3, "tests": tests, "seed": seed, "unattended": True}
    now_s = 0.0
    loop.server_alive(now_s)
    loop.handle({"type": "connect", "source": "bench"}, now_s)
    loop.tick(now_s)
    loop.handle({"type": "arm", "plan": plan}, now_s)
    loop.handle({"type": "start"}, now_s)
    while loop.state is State.RUNNING:
        now_s += source.step_s
        loop.server_alive(now_s)
        loop.tick(now_s)
    if loop.describe()["reason"]:
        raise RuntimeError(str(loop.describe()["reason"]))
    loop.close()
    return folder / "campaigns" / "fixed", source.seconds


def random_tests(rig: Rig, folder: Path, seed: int, seconds: float) -> Path:
    """Run PRBS tests between two commands drawn up to the limits, from where the machine is; see the page."""
    source = Watched(rig, seed)
    rng = np.random.default_rng(seed)
    machine = Machine(source.signals, source.step_s, source.step_s, source.limits)
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text(COLUMNS)
    source.open()
    logs: dict[str, list[tuple[float, ...]]] = {}

    def carry_out(program: Generator[Step, float, object]) -> None:
        measured = None
        while source.seconds < seconds:
            try:
                step = next(program) if measured is None else program.send(measured)
            except StopIteration:
                return
            time_s, values = source.read()[-1]
            if step.log:
                logs.setdefault(step.log, []).append((time_s, *step.commands, values[2]))
            source.write(step.commands)
            measured = source.read()[-1].values[2]

    number = 0
    while source.seconds < seconds:
        at_mm = source.read()[-1].values[2]
        low, high = source.limits.displacement
        channel = int(rng.random() > (high - at_mm) / (high - low))
        levels = np.sort(rng.uniform(0, source.limits.commands[channel], 2))
        clock = max(1, round(rng.uniform(0.15, 0.4) / source.step_s))
        held = np.repeat(rng.integers(0, 2, 2000 // clock), clock)[:1000]
        rows = two_channel_command(DIRECTIONS[channel], levels[held])
        number += 1
        carry_out(guarded(at_mm, rows, f"random-{number:02d}", machine, 0.1))
        at_mm = source.read()[-1].values[2]
        end = low + 0.04 * (high - low) if rng.random() < 0.5 else high - 0.04 * (high - low)
        carry_out(move(at_mm, end, source.limits, source.step_s))
    for name, rows in logs.items():
        time_s, up, down, at_mm = np.array(rows).T
        columns = {"time_s": time_s - time_s[0], "current_up_A": up, "current_down_A": down}
        if len(rows) > 100:
            write_table(folder / f"{name}.csv", {**columns, "displacement_mm": at_mm})
    return folder


def part_of(folder: Path, minutes: float, out: Path) -> Path:
    """Copy what a campaign had logged after some minutes of bench time, by the times of its rounds."""
    rounds = json.loads((folder / "progress.json").read_bytes())["rounds"]
    count = max(entry["tests"] for entry in rounds if entry["minutes"] <= minutes)
    logs = sorted([*folder.glob("*.csv"), *folder.glob("*/*.csv")], key=lambda log: log.stat().st_mtime_ns)
    out.mkdir(parents=True)
    chosen = [log for log in logs[:count] if log.parent == folder]
    for log in chosen:
        shutil.copy2(log, out)
    text = (folder / "campaign.toml").read_text()
    if not any(log.name.startswith("validation-") for log in chosen):
        text = text.partition("[split]")[0]
    (out / "campaign.toml").write_text(text)
    CampaignFiles(out).settle_form(DIRECTIONS)
    return out


@double_precision
def unseen(rig: Rig, seed: int, folder: Path) -> "hitchid.Campaign":
    """Return 20 + 20 PRBS tests of a machine that no campaign has seen."""
    folder.mkdir(parents=True)
    for log in run(rig, {"prbs": 20}, seed=seed):
        write_table(folder / f"{log.name}.csv", log.columns)
    (folder / "campaign.toml").write_text(COLUMNS)
    return hitchid.read(folder)


def errors(logs: Path, tests: "hitchid.Campaign", training: bool) -> dict[str, float]:
    """Return the free-run RMSE of the model of some logs on unseen tests, by direction, mm.

    It is the default one, but for the settings that a campaign of few tests gives.
    """
    settings = dict(read_settings(logs / SETTINGS)) if (logs / SETTINGS).exists() else {}
    if not training:
        settings["training"] = None
    try:
        found = hitchid.identify(hitchid.read(logs), progress=False, **{**settings, "rivals": None})
    except hitchid.HitchError as error:
        sys.stderr.write(f"   {logs.name}: {error}\n")
        return {}
    squares: dict[str, list[float]] = {}
    for record in tests.records:
        direction = record.name.split("-")[0]
        if direction in found.model.channels:
            error = found.model.simulate(record).displacement - record.displacement
            squares.setdefault(direction, []).append(float(np.mean(error**2)))
    parameters = [e for trace in found.channels.values() for e in trace.phase1.parameter_estimates]
    determined = sum(e.determined for e in parameters) / max(1, len(parameters))
    return {d: float(np.sqrt(np.mean(s))) for d, s in squares.items()} | {"determined": determined}


def compare(number: int, training: bool, folder: Path) -> dict[str, dict[str, float]]:
    """Return the errors of all programmes on one machine."""
    rig = drawn_machine(number)
    tests = unseen(rig, 900 + number, folder / "unseen")
    fixed, fixed_s = fixed_programme(rig, folder / "project", number)
    source = Watched(rig, 100 + number)
    result = campaign(
        source, folder / "project", name="adaptive", minutes=SHARES[-1] * fixed_s / 60,
        limits=source.limits, seed=number,
    )  # fmt: skip
    found = {"fixed": errors(fixed, tests, training)}
    for share in SHARES:
        part = part_of(result.folder, share * fixed_s / 60, folder / f"part-{share:g}")
        found[f"adaptive {share:.0%}"] = errors(part, tests, training)
    logs = random_tests(rig, folder / "random", 200 + number, SHARES[0] * fixed_s)
    found["random 25%"] = errors(logs, tests, training)
    found["bench"] = {
        "fixed_min": fixed_s / 60, "adaptive_min": result.minutes, "stops": source.stops,
        "both": source.both, "beyond": source.beyond,
    }  # fmt: skip
    return found


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Print the errors of each machine, and their ratios over all machines."""
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="?", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--physics", action="store_true", help="physics alone, without trained corrections")
    parser.add_argument("--keep", type=Path, help="folder to keep the logs in")
    arguments = parser.parse_args()
    prepare_jax()
    ratios: dict[str, list[float]] = {}
    for number in range(arguments.first, arguments.first + arguments.machines):
        with tempfile.TemporaryDirectory() as temporary:
            folder = (arguments.keep or Path(temporary)) / f"machine-{number:02d}"
            found = compare(number, not arguments.physics, folder)
        bench = found.pop("bench")
        _say(f"machine {number}: " + ", ".join(f"{key} {value:.3g}" for key, value in bench.items()))
        for name, by_direction in found.items():
            _say(f"  {name:14s} { ({key: round(value, 4) for key, value in by_direction.items()}) }")
        for name in list(found)[1:]:
            own, fixed = (
                np.linalg.norm([errors_of.get(direction, np.inf) for direction in DIRECTIONS])
                for errors_of in (found[name], found["fixed"])
            )
            ratios.setdefault(name, []).append(float(own / fixed))
    for name, values in ratios.items():
        _say(f"{name}: ratio to the fixed programme, median {np.median(values):.3g}, {np.round(values, 2)}")


if __name__ == "__main__":
    main()
