"""Do 95 % intervals hold the truth? Simulated campaigns of known plants, tests with coloured noise.

Twelve tests of 6 s a campaign: a random binary command behind a dead zone that three ramps found, a plant in
one of the structures, errors of a first-order Markov process (0.3 mm, 1 s) and white noise of 0.05 mm.
Prints a Markdown table of how often the interval holds the truth, and of the verdicts.

    python benchmarks/coverage.py [CAMPAIGNS]
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

from hitchid.data.record import LIFTING, Record
from hitchid.estimation import MultiStart
from hitchid.experiments.excitation import prbs, precompensated
from hitchid.identification.phase1 import identify_benchmark
from hitchid.model import Interval
from hitchid.structures import Batch, ModelSpec, PhysicalModel, Scales, structure_named
from hitchid.uncertainty import DeadZoneError

TESTS, DURATION_S, STEP_S = 12, 6.0, 0.01
DEAD_ZONE_A, DEAD_ZONE_SPREAD_A = 0.38, 0.002
COLOURED_MM, COLOURED_S, WHITE_MM = 0.3, 1.0, 0.05
HIGHEST_A = 0.8
UNITS = {"x": "mm", "u": "A"}
CURVE_PARAMETERS = {"opening": 0.05, "exponent": 1.3, "saturation": 1.5}
SCALES = Scales(*map(jnp.asarray, (HIGHEST_A, 0.0, 1.0, 0.0, 1.0)))


@dataclass(frozen=True)
class Plant:
    """A plant, and how its tests are run.

    Attributes:
        form: what is identified.
        truth: the parameters it was simulated with; infinite for a time constant that is not there.
        clock_s: shortest time a level of the command is held, s.
        simulated: structure of the truth, where it is another than the form's.
    """

    form: ModelSpec
    truth: Mapping[str, float]
    clock_s: float = 0.2
    simulated: str = ""

    def benchmark(self) -> PhysicalModel:
        """Return the truth."""
        form = replace(self.form, structure=structure_named(self.simulated)) if self.simulated else self.form
        values = [self.truth[parameter.name] for parameter in form.parameters]
        return form.physical_model(jnp.asarray(values), SCALES)


PLANTS = {
    "second order": Plant(
        ModelSpec(structure_named("integrator-second-order")),
        {"gain": 40.0, "natural_frequency": 12.0, "damping_ratio": 0.7},
    ),
    "first order, dead time": Plant(
        ModelSpec(structure_named("integrator-first-order"), dead_time=True),
        {"gain": 30.0, "time_constant": 0.1, "dead_time": 0.03},
    ),
    "lag of 8 s": Plant(ModelSpec(structure_named("first-order-lag")), {"gain": 30.0, "time_constant": 8.0}),
    "first order, valve curve": Plant(
        ModelSpec(
            structure_named("integrator-first-order"), valve_curve=True, bounds={"opening": (-0.2, 0.2)}
        ),
        {"gain": 40.0, "time_constant": 0.1, **CURVE_PARAMETERS},
    ),
    "lag that is an integrator": Plant(
        ModelSpec(structure_named("first-order-lag")),
        {"gain": 30.0, "time_constant": np.inf},
        simulated="integrator",
    ),
    "second order, too fast for a slow clock": Plant(
        ModelSpec(structure_named("integrator-second-order")),
        {"gain": 40.0, "natural_frequency": 150.0, "damping_ratio": 0.7},
        clock_s=1.0,
    ),
}


def campaign(plant: Plant, rng: np.random.Generator) -> tuple[list[Record], float, DeadZoneError]:
    """Return the tests of one campaign, the dead zone that ramps gave, and how well it is known."""
    records = [test(plant, rng, number) for number in range(TESTS)]
    ramps = DEAD_ZONE_A + DEAD_ZONE_SPREAD_A * rng.standard_normal(3)
    return records, float(ramps.mean()), DeadZoneError(float(ramps.std(ddof=1) / np.sqrt(3)), 3)


def test(plant: Plant, rng: np.random.Generator, number: int) -> Record:
    """Return one test of a campaign; the first goes to the highest command."""
    signal = prbs(
        low=rng.uniform(0.03, 0.2),
        high=rng.uniform(0.4, 1.0) * HIGHEST_A if number else HIGHEST_A,
        clock_s=plant.clock_s,
        duration_s=DURATION_S,
        seed=int(rng.integers(2**31)),
    )
    return record_of(plant, precompensated(signal.command, DEAD_ZONE_A), rng, f"{number}")


def record_of(plant: Plant, command: np.ndarray, rng: np.random.Generator, name: str) -> Record:
    """Return what a plant answers to a command as logged, with its errors."""
    signals = {"displacement": np.zeros(command.size), "lifting_command": command}
    units = {"displacement": UNITS["x"], "lifting_command": UNITS["u"]}
    rest_batch = Batch.of([Record(name, STEP_S, signals, units)], LIFTING, dead_zone=DEAD_ZONE_A, sign=1)
    travel = np.asarray(plant.benchmark().travel(rest_batch))[0, : command.size]
    decay = np.exp(-STEP_S / COLOURED_S)
    innovations = COLOURED_MM * np.sqrt(1 - decay**2) * rng.standard_normal(command.size)
    innovations[0] = COLOURED_MM * rng.standard_normal()
    noise = lfilter([1.0], [1.0, -decay], innovations) + WHITE_MM * rng.standard_normal(command.size)
    return Record(name, STEP_S, {**signals, "displacement": travel + noise}, units)


def main() -> None:
    """Identify every plant from so many campaigns and count."""
    jax.config.update("jax_enable_x64", True)
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    say = sys.stdout.write
    header = (
        "plant",
        "parameter",
        "truth in the interval / %",
        "in the bootstrap's / %",
        "called determined / %",
    )
    say(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    for name, plant in PLANTS.items():
        rng = np.random.default_rng(0)
        all_estimates = []
        for _ in range(campaigns):
            records, zone, error = campaign(plant, rng)
            batch = Batch.of(records, LIFTING, dead_zone=zone, sign=1)
            phase1 = identify_benchmark(
                batch, plant.form, MultiStart(starts=2), 0, units=UNITS, dead_zone=error
            )
            all_estimates.append(
                {
                    parameter_estimate.name: parameter_estimate
                    for parameter_estimate in phase1.parameter_estimates
                }
            )
        for parameter, truth in plant.truth.items():
            estimates = [campaign[parameter] for campaign in all_estimates]
            covered = [_covers(estimate.interval, truth) for estimate in estimates]
            bootstrap_covered = [
                estimate.bootstrap is not None and _covers(estimate.bootstrap, truth)
                for estimate in estimates
            ]
            determined = [estimate.determined for estimate in estimates]
            cells = (
                name,
                parameter,
                *(f"{100 * np.mean(row):.1f}" for row in (covered, bootstrap_covered, determined)),
            )
            say(f"| {' | '.join(cells)} |\n")
            sys.stdout.flush()


def _covers(interval: Interval, truth: float) -> bool:
    lower, upper = interval
    return (lower is None or lower <= truth) and (upper is None or truth <= upper)


if __name__ == "__main__":
    main()
