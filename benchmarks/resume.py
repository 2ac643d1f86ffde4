"""Kills `hitchid identify` at random moments, has each run go on, and compares the models byte by byte.

python benchmarks/resume.py [--kills 30] [--seed 0]
"""

import argparse
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HITCHID = Path(sys.executable).with_name("hitchid")
SETTINGS = """[lifting]
structure = "integrator-second-order"
[lowering]
structure = "first-order-lag"
[search]
evaluations = 300
compare = false
[training]
epochs = 10
baselines = false
"""
FILES = ("model.json", "weights.safetensors", "trace.json")


def main() -> None:
    """Print each run that was killed, and whether its model is that of the run that was not."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kills", type=int, default=30)
    options.add_argument("--seed", type=int, default=0)
    arguments = options.parse_args()
    moments = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "settings.toml").write_text(SETTINGS)
        bench = [HITCHID, "bench", root / "logs", "--tests", "6"]
        subprocess.run(bench, check=True)  # noqa: S603
        reference = root / "whole"
        _finish(root, reference)  # compiles what every run needs
        shutil.rmtree(reference)
        started = time.monotonic()
        _finish(root, reference)
        lasting_s = time.monotonic() - started
        _say(f"uninterrupted: {lasting_s:.1f} s")
        kills = runs = 0
        while kills < arguments.kills:
            runs += 1
            model = root / f"model-{runs}"
            kill_times = []
            while True:
                moment = moments.uniform(0.0, lasting_s)
                if _kill_after(root, model, moment):
                    kill_times.append(moment)
                if len(kill_times) >= 3 or model.is_dir():
                    break
            kills += len(kill_times)
            _finish(root, model)
            same = all((model / name).read_bytes() == (reference / name).read_bytes() for name in FILES)
            leftovers = sorted(
                path.name
                for path in root.iterdir()
                if path.name.startswith((f"{model.name}.", f".{model.name}"))
            )
            times_text = ", ".join(f"{kill_time:.1f}" for kill_time in kill_times) or "no moment"
            _say(f"run {runs}, killed at {times_text} s: same model: {same}, left behind: {leftovers}")
            if not same:
                sys.exit(1)


def _command(root: Path, model: Path) -> list[str | Path]:
    options = ["--config", root / "settings.toml", "--quiet", "--resume"]
    return [HITCHID, "identify", root / "logs", "--out", model, *options]


def _finish(root: Path, model: Path) -> None:
    if not model.is_dir() or model.with_name(f"{model.name}.unfinished").is_dir():
        subprocess.run(_command(root, model), check=True)  # noqa: S603


def _kill_after(root: Path, model: Path, after_s: float) -> bool:
    process = subprocess.Popen(_command(root, model), stderr=subprocess.PIPE)  # noqa: S603
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return True
    return False


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
