"""Is the advised test worth more than one more of the usual? Simulated campaigns, both tests run.

The plants of `coverage.py`, those whose parameters are all determined. A campaign of twelve tests is
identified, `hitchid.control.next_test` proposes a thirteenth for the parameter with the widest interval, it
is run on the plant, and the campaign identified again; beside it with one more test like the twelve. Prints
by how much either cuts the interval.

    python benchmarks/advice.py [CAMPAIGNS]
"""

import sys

import jax
import numpy as np
from coverage import PLANTS, UNITS, Plant, campaign, make_test, record_of

from hitchid.control.next_test import ExcitationLimits, command_of, design
from hitchid.estimation import MultiStart
from hitchid.identification.direction import operating_range_of
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.logs.record import COMMAND, DISPLACEMENT, LIFTING
from hitchid.model import Channel, Hitch, Uncertainty
from hitchid.structures import Batch
from hitchid.uncertainty import information_of


def main() -> None:
    """Run the comparison on every plant that is determined."""
    jax.config.update("jax_enable_x64", True)
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    say = sys.stdout.write
    header = ("plant", "parameter, campaigns", "one more / %", "advised / %", "ratio")
    say(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    for name, plant in PLANTS.items():
        if plant.simulated or plant.clock_s > 0.5:
            continue
        rng = np.random.default_rng(1)
        reductions: dict[str, list[tuple[float, float]]] = {}
        for _ in range(campaigns):
            parameter, reduction = _interval_reductions(plant, rng)
            reductions.setdefault(parameter, []).append(reduction)
        for parameter, pairs in reductions.items():
            baseline, advised = 100 * np.mean(pairs, axis=0)
            cells = (
                name,
                f"{parameter}, {len(pairs)}",
                f"{baseline:.1f}",
                f"{advised:.1f}",
                f"{advised / baseline:.1f}",
            )
            say(f"| {' | '.join(cells)} |\n")
            sys.stdout.flush()


def _interval_reductions(plant: Plant, rng: np.random.Generator) -> tuple[str, tuple[float, float]]:
    """Return the parameter that is to be narrowed, and by what share either test cuts its interval."""
    records, zone, error = campaign(plant, rng)

    def run_phase1(tests: list) -> Phase1:
        batch = Batch.of(tests, LIFTING, dead_zone=zone, sign=1)
        return identify_benchmark(batch, plant.form, MultiStart(starts=2), 0, units=UNITS, dead_zone=error)

    initial_fit = run_phase1(records)
    hitch = _hitch(initial_fit, zone)
    determined = [estimate for estimate in initial_fit.parameter_estimates if estimate.determined]
    target = max(determined, key=lambda estimate: estimate.log_interval_width).name
    longest = records[0].step_s * (len(records[0]) - 1)
    advice = design(hitch, LIFTING, parameter=target, limits=ExcitationLimits(longest_s=longest))
    command = command_of(hitch, LIFTING, advice.proposals[0])
    advised = run_phase1([*records, record_of(plant, command, rng, "advised")])
    baseline = run_phase1([*records, make_test(plant, rng, len(records))])

    def width(phase1: Phase1) -> float:
        return next(
            estimate.log_interval_width for estimate in phase1.parameter_estimates if estimate.name == target
        )

    initial_width = width(initial_fit)
    return target, (1 - width(baseline) / initial_width, 1 - width(advised) / initial_width)


def _hitch(phase1: Phase1, zone: float) -> Hitch:
    fit = phase1.fit
    channel = Channel(
        LIFTING, 1, zone, None, phase1.benchmark, operating_range=operating_range_of(fit.objective.batch)
    )
    uncertainty = Uncertainty(
        phase1.assessment, information=information_of(fit.objective, fit.position, phase1.influence)
    )
    units = {DISPLACEMENT: UNITS["x"], COMMAND[LIFTING]: UNITS["u"]}
    return Hitch({LIFTING: channel}, fit.objective.batch.step_s, units, uncertainty={LIFTING: uncertainty})


if __name__ == "__main__":
    main()
