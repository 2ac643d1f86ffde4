"""Speed of the virtual bench after compilation, as a multiple of real time; prints a Markdown table."""

import sys
import time

import jax
import numpy as np

from hitchid.rig import load_rig, simulate
from hitchid.rig.simulation import SUBSTEPS

SAMPLES = 1001
REPEATS = 5


def main() -> None:
    """Simulate one test and forty of 10 s, with the default step and a finer one."""
    rig, rng, say = load_rig("nominal"), np.random.default_rng(0), sys.stdout.write
    say("| tests | substeps | s | times real time |\n| --- | --- | --- | --- |\n")
    for tests in (1, 40):
        levels = rng.uniform(0.35, 0.7, (tests, 20, 2)) * np.array([1.0, 0.0])
        currents = np.repeat(levels, 51, axis=1)[:, :SAMPLES]
        for substeps in (SUBSTEPS, 2 * SUBSTEPS, 4 * SUBSTEPS):
            spent = []
            for _ in range(REPEATS + 1):
                start = time.perf_counter()
                motion = simulate(rig, currents, initial_displacement_m=0.05, substeps=substeps)
                jax.block_until_ready(motion.displacement_m)
                spent.append(time.perf_counter() - start)
            best = min(spent[1:])
            say(f"| {tests} | {substeps} | {best:.4f} | {tests * 10.0 / best:.0f} |\n")


if __name__ == "__main__":
    main()
