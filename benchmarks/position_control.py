"""Position control of the three benches: the table of docs/howto/position-control.md.

    python -m benchmarks.position_control [--draws 20] [--seed 1] [RIG ...]

Each bench is identified by default from 20 tests per direction, tuned and driven through all scenarios.
"""

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hitchid
from hitchid.control import drive, tune
from hitchid.experiments.virtual_campaign import write_campaign
from hitchid.rig import load_rig

RIGS = ("nominal", "light-warm-worn", "heavy-cold")
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
    "sine 10 mm, 0.1 Hz: RMSE, mm": ("sine", "rmse"),
    "ramps ±8 mm/s: RMSE, mm": ("ramps", "rmse"),
    "valve actions in 10 s of holding": ("hold", "valve_actions_per_10_s"),
    "samples with both valves on": ("both_valves_samples",),
    "samples with current after the sensor is lost": ("sensor_lost", "samples_until_closed"),
    "share of loops inside the predicted band": ("band", "inside"),
    "`iae_ratio`": ("iae_ratio",),
    "IAE of steps alone over that of SIMC PI": ("iae_ratios", "step"),
}


def metrics_of(rig: str, draws: int, seed: int) -> Mapping[str, Any]:
    """Return the figures of one bench."""
    bench = load_rig(rig)
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder) / "logs"
        write_campaign(logs, rig, tests={"prbs": 20}, seed=seed)
        model = hitchid.identify(hitchid.read(logs)).model
    return drive(tune(model).controller, bench, model=model, draws=draws).metrics


def value(metrics: Mapping[str, Any], path: tuple[str, ...]) -> str:
    """Return the figure at a path as text."""
    found: Any = metrics
    for name in path:
        found = found[name]
    return "never" if found is None else f"{found:.3g}"


def main() -> None:
    """Print one column for each bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rigs", nargs="*", default=RIGS)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    found = {rig: metrics_of(rig, arguments.draws, arguments.seed) for rig in arguments.rigs}
    lines = [["figure", *found], ["---", *["---:"] * len(found)]]
    for title, path in ROWS.items():
        lines.append([title, *(value(metrics, path) for metrics in found.values())])
    changed = (max(metrics["changes"].values()) for metrics in found.values())
    lines.append(["load or oil changed: IAE over that without, largest", *(f"{x:.3g}" for x in changed)])
    sys.stdout.writelines(f"| {' | '.join(cells)} |\n" for cells in lines)


if __name__ == "__main__":
    main()
