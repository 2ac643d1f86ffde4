"""Is the same form chosen from tests that differ a little, and how far do its errors scatter?

    python -m benchmarks.stability SET [SET ...] [--repeats 10]

Each repeat leaves out one test of each direction and adds white noise of the sensor's floor to the
displacement, identifies (physics only) and predicts the unseen tests. Sets: those of `benchmarks.free_run`.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import hitchid
from hitchid.identification.repeated_choice import form_name
from hitchid.logs.record import DISPLACEMENT

from .free_run import SETS

PHYSICS = {"training": None, "rivals": None}


class Repeat(NamedTuple):
    """One choice: structure and parameters of a direction, free run of unseen tests."""

    form: str
    rmse: float
    least_r2: float


def results(campaign: hitchid.Campaign) -> tuple[hitchid.Hitch, dict[str, Repeat]]:
    """Identify and validate; return the model, and direction to result."""
    identification = hitchid.identify(campaign, **PHYSICS)
    channels = hitchid.validate(identification.model, campaign).metrics["channels"]
    repeats = {}
    for direction, trace in identification.channels.items():
        form = form_name(trace.phase1.fit.objective.spec)
        fits = [test["free_run"]["r2"] for test in channels[direction]["per_test"].values()]
        repeats[direction] = Repeat(form, channels[direction]["benchmark"]["free_run"]["rmse"], min(fits))
    return identification.model, repeats


def perturbed(campaign: hitchid.Campaign, model: hitchid.Hitch, repeats: int) -> Iterator[hitchid.Campaign]:
    """Yield the campaign without one test of each direction, each time another, and with more noise."""
    noise = min(float(channel.load_filter.noise) for channel in model.channels.values())
    held_out = {record.name for direction in campaign.directions for record in campaign.held_out(direction)}
    identification_names = {
        direction: [record.name for record in campaign.of_kind(direction) if record.name not in held_out]
        for direction in campaign.directions
    }
    for number in range(repeats):
        rng = np.random.default_rng(number)
        left_out = {names[number % len(names)] for names in identification_names.values() if len(names) > 1}
        records = []
        for record in campaign.records:
            samples = record.displacement + noise * rng.standard_normal(len(record))
            noisy = replace(record, signals={**record.signals, DISPLACEMENT: samples})
            if record.name not in left_out:
                records.append(record if record.name in held_out else noisy)
        yield replace(campaign, records=tuple(records))


def main() -> None:
    """Print what each repeat chose, and how often it was what most of them chose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", choices=SETS)
    parser.add_argument("--repeats", type=int, default=10)
    arguments = parser.parse_args()
    for name in arguments.sets:
        campaign = SETS[name].campaign()
        model, first = results(campaign)
        rows = [first, *(results(other)[1] for other in perturbed(campaign, model, arguments.repeats))]
        for direction in first:
            for number, repeat in enumerate(row[direction] for row in rows):
                label = f"{name}, {direction}, {f'repeat {number}' if number else 'all tests'}"
                sys.stdout.write(
                    f"{label}: RMSE {repeat.rmse:.4g}, worst R² {repeat.least_r2:.4f}; {repeat.form}\n"
                )
            repeats = [row[direction] for row in rows[1:]]
            ((form, count),) = Counter(repeat.form for repeat in repeats).most_common(1)
            errors = [repeat.rmse for repeat in repeats]
            sys.stdout.write(
                f"{name}, {direction}: same form in {count} of {len(repeats)} ({form}); RMSE "
                f"{min(errors):.4g} to {max(errors):.4g}, worst R² {min(r.least_r2 for r in repeats):.4f}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
