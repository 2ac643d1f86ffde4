"""Is the advised test worth more than one more of the usual? Simulated campaigns, both tests run.

The plants of `coverage.py`, those whose parameters are all determined. A campaign of twelve tests is
identified, `hitchid.design` proposes a thirteenth for the parameter with the widest interval, it is run on
the plant, and the campaign identified again; beside it with one more test like the twelve. Prints by how
much either cuts the interval.

    python benchmarks/advice.py [CAMPAIGNS]
"""

import sys

import jax
import numpy as np
from coverage import PLANTS, UNITS, Plant, campaign, record_of, test

from hitchid.data.record import COMMAND, DISPLACEMENT, LIFTING
from hitchid.design import Limits, command_of, design
from hitchid.estimation import MultiStart
from hitchid.identification.direction import envelope_of
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.model import Channel, Hitch
from hitchid.structures import Batch
from hitchid.uncertainty import Information, Uncertainty


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
        cuts: dict[str, list[tuple[float, float]]] = {}
        for _ in range(campaigns):
            parameter, cut = _cuts(plant, rng)
            cuts.setdefault(parameter, []).append(cut)
        for parameter, pairs in cuts.items():
            usual, advised = 100 * np.mean(pairs, axis=0)
            cells = (
                name,
                f"{parameter}, {len(pairs)}",
                f"{usual:.1f}",
                f"{advised:.1f}",
                f"{advised / usual:.1f}",
            )
            say(f"| {' | '.join(cells)} |\n")
            sys.stdout.flush()


def _cuts(plant: Plant, rng: np.random.Generator) -> tuple[str, tuple[float, float]]:
    """Return the parameter that is to be narrowed, and by what share either test cuts its interval."""
    records, zone, error = campaign(plant, rng)

    def identified(tests: list) -> Phase1:
        batch = Batch.of(tests, LIFTING, dead_zone=zone, direction=1)
        return identify_benchmark(batch, plant.form, MultiStart(starts=2), 0, units=UNITS, dead_zone=error)

    found = identified(records)
    hitch = _hitch(found, zone)
    sure = [each for each in found.estimates if each.determined]
    target = max(sure, key=lambda each: each.vagueness).name
    longest = records[0].step_s * (len(records[0]) - 1)
    advice = design(hitch, LIFTING, parameter=target, limits=Limits(longest_s=longest))
    command = command_of(hitch, LIFTING, advice.proposals[0])
    advised = identified([*records, record_of(plant, command, rng, "advised")])
    usual = identified([*records, test(plant, rng, len(records))])

    def width(phase1: Phase1) -> float:
        return next(each.vagueness for each in phase1.estimates if each.name == target)

    now = width(found)
    return target, (1 - width(usual) / now, 1 - width(advised) / now)


def _hitch(found: Phase1, zone: float) -> Hitch:
    fit = found.fit
    channel = Channel(LIFTING, 1, zone, None, found.benchmark, envelope=envelope_of(fit.misfit.batch))
    known = Uncertainty(found.known, information=Information.of(fit.misfit, fit.position, found.moved))
    units = {DISPLACEMENT: UNITS["x"], COMMAND[LIFTING]: UNITS["u"]}
    return Hitch({LIFTING: channel}, fit.misfit.batch.step_s, units, uncertainty={LIFTING: known})


if __name__ == "__main__":
    main()
