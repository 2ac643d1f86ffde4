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
    asked = options.parse_args()
    moments = np.random.default_rng(asked.seed)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "settings.toml").write_text(SETTINGS)
        bench = [HITCHID, "bench", place / "logs", "--tests", "6"]
        subprocess.run(bench, check=True)  # noqa: S603
        whole = place / "whole"
        _finish(place, whole)  # compiles what every run needs
        shutil.rmtree(whole)
        started = time.monotonic()
        _finish(place, whole)
        lasting_s = time.monotonic() - started
        _say(f"uninterrupted: {lasting_s:.1f} s")
        kills = runs = 0
        while kills < asked.kills:
            runs += 1
            model = place / f"model-{runs}"
            at = []
            while True:
                moment = moments.uniform(0.0, lasting_s)
                if _killed(place, model, moment):
                    at.append(moment)
                if len(at) >= 3 or model.is_dir():
                    break
            kills += len(at)
            _finish(place, model)
            same = all((model / name).read_bytes() == (whole / name).read_bytes() for name in FILES)
            left = sorted(
                path.name
                for path in place.iterdir()
                if path.name.startswith((f"{model.name}.", f".{model.name}"))
            )
            told = ", ".join(f"{each:.1f}" for each in at) or "no moment"
            _say(f"run {runs}, killed at {told} s: same model: {same}, left behind: {left}")
            if not same:
                sys.exit(1)


def _command(place: Path, model: Path) -> list[str | Path]:
    options = ["--config", place / "settings.toml", "--quiet", "--resume"]
    return [HITCHID, "identify", place / "logs", "--out", model, *options]


def _finish(place: Path, model: Path) -> None:
    if not model.is_dir() or model.with_name(f"{model.name}.unfinished").is_dir():
        subprocess.run(_command(place, model), check=True)  # noqa: S603


def _killed(place: Path, model: Path, after_s: float) -> bool:
    process = subprocess.Popen(_command(place, model), stderr=subprocess.PIPE)  # noqa: S603
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
