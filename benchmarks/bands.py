"""Do 90 % bands hold 90 % of the samples? A hundred unseen tests a direction of the virtual bench.

Identifies the virtual bench from twenty tests a direction, sixteen of them for identification, and validates
on a hundred of another seed. Prints a Markdown table of what the bands cover and how wide they are.

    python benchmarks/bands.py [RIG]
"""

import sys
import tempfile
from pathlib import Path

import jax

import hitchid
from hitchid.experiments.virtual_campaign import write_campaign

TESTS, UNSEEN = 20, 100


def main() -> None:
    """Identify and validate."""
    jax.config.update("jax_enable_x64", True)
    rig = sys.argv[1] if len(sys.argv) > 1 else "nominal"
    with tempfile.TemporaryDirectory() as folder:
        training_logs, unseen = Path(folder) / "known", Path(folder) / "unseen"
        write_campaign(training_logs, rig, tests={"ramp": 3, "prbs": TESTS}, seed=0)
        write_campaign(unseen, rig, tests={"prbs": UNSEEN}, seed=7)
        model = hitchid.identify(hitchid.read(training_logs), comparison=None).model
        metrics = hitchid.validate(model, hitchid.read(unseen)).metrics
    say = sys.stdout.write
    header = ("direction", "prediction", "covered / %", f"mean width / {metrics['unit']}")
    say(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    for direction, channel in metrics["channels"].items():
        bands = channel["bands"]
        free, horizons = bands["free_run"], bands["horizons"]
        rows = [("free run", free["covered"], free["width"])]
        rows += [
            (f"{step} ahead", covered, width)
            for step, covered, width in zip(
                horizons["steps"], horizons["covered"], horizons["width"], strict=True
            )
        ]
        for name, covered, width in rows:
            say(f"| {direction} | {name} | {100 * covered:.1f} | {width:.3f} |\n")


if __name__ == "__main__":
    main()
