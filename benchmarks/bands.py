"""Do 90 % bands hold 90 % of the samples of unseen tests, in free run and at every horizon?

Identifies each rig of the virtual bench from twenty tests a direction, sixteen of them for identification,
and predicts a hundred tests of another seed, forty of the rigs other than nominal. Prints a Markdown table of
what the bands cover and how wide they are, with the horizons that are covered least and most.

    python benchmarks/bands.py [RIG ...] [--seed 0]
"""

import argparse
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

import hitchid
from hitchid.baselines.registry import delayed
from hitchid.bench.virtual_campaign import write_campaign
from hitchid.model import Bands, Channel
from hitchid.model.bands import free_run_half_width
from hitchid.model.free_run import ensemble_deviations
from hitchid.structures import Batch
from hitchid.validation.channels import COVERAGE

TESTS, UNSEEN = 20, {"nominal": 100, "heavy-cold": 40, "light-warm-worn": 40}
HORIZONS = tuple(range(1, 101))
SHOWN = (1, 10, 50, 100)


def main() -> None:
    """Identify and predict."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rigs", nargs="*", default=[], choices=[*UNSEEN, []])
    parser.add_argument("--seed", type=int, default=0, help="of the identification tests")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    say = sys.stdout.write
    header = ("rig", "direction", "prediction", "covered / %", "mean width / mm")
    say(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    for rig in arguments.rigs or UNSEEN:
        with tempfile.TemporaryDirectory() as folder:
            known, unseen = Path(folder) / "known", Path(folder) / "unseen"
            write_campaign(known, rig, tests={"ramp": 3, "prbs": TESTS}, seed=arguments.seed)
            write_campaign(unseen, rig, tests={"prbs": UNSEEN[rig]}, seed=7)
            model = hitchid.identify(hitchid.read(known)).model
            tests = hitchid.read(unseen)
        for direction, channel in model.channels.items():
            bands = model.uncertainty[direction].bands
            if bands is None:
                continue
            for name, covered, width in rows(channel, bands, channel.batch(tests.of_kind(direction))):
                say(f"| {rig} | {direction} | {name} | {100 * covered:.1f} | {width:.3f} |\n")


def rows(channel: Channel, bands: Bands, batch: Batch) -> list[tuple[str, float, float]]:
    """Return name, share covered and mean width: of the free run, of some horizons, of the extreme ones."""
    measured, loss_mask = np.asarray(batch.displacement), np.asarray(batch.loss_mask)

    def covered(predicted: np.ndarray, half_width: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
        inside = (np.abs(measured - predicted) <= half_width) & mask
        return float(np.mean(inside.sum(axis=1) / mask.sum(axis=1))), float(np.mean(2 * half_width[mask]))

    _, deviations = ensemble_deviations(channel, bands.ensemble, batch)
    band = free_run_half_width([bands], [np.sqrt(np.sum(deviations**2, axis=0))], COVERAGE)
    free_run = covered(np.asarray(channel.simulate(batch)), band, loss_mask)
    ahead = {}
    for horizon, predicted in zip(HORIZONS, np.asarray(channel.predict(batch, HORIZONS)), strict=True):
        half_width = bands.half_width(COVERAGE, horizon, predicted - delayed(measured, horizon))
        mask = loss_mask & (np.arange(loss_mask.shape[1]) >= horizon)
        ahead[horizon] = covered(predicted, half_width, mask)
    by_coverage = sorted(ahead, key=lambda horizon: ahead[horizon][0])
    return [
        ("free run", *free_run),
        *((f"{horizon} ahead", *ahead[horizon]) for horizon in SHOWN),
        (f"least of 1 to 100: {by_coverage[0]} ahead", *ahead[by_coverage[0]]),
        (f"most of 1 to 100: {by_coverage[-1]} ahead", *ahead[by_coverage[-1]]),
    ]


if __name__ == "__main__":
    main()
