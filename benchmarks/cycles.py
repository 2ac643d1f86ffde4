"""Mixed logs alone: the figures of docs/switching.md that `hitchid validate` does not print.

    python benchmarks/cycles.py [rig-a] [hanging-load]

rig-a: each cycle left out in turn, identified from the others. hanging-load: the first two thirds of the
lifting and of the lowering part, free run over the rest, beside each channel for both directions. Data from
HITCHID_DATA.
"""

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import hitchid
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import CYCLE, LIFTING, LOWERING, Record
from hitchid.model import Hitch

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
REVERSAL_S = 186.0


def free_run_rmse(model: Hitch, record: Record) -> float:
    """Return the root mean square error of a free run, in the record's unit."""
    return float(np.sqrt(np.mean((model.simulate(record).displacement - record.displacement) ** 2)))


def leave_one_out() -> None:
    """Print the error on each cycle of rig-a, identified from the others, without and with creep."""
    cycles = hitchid.read(DATA / "rig-a").of_kind(CYCLE)
    for test in cycles:
        campaign = Campaign(cycles, (test.name,))
        for drift in (False, True):
            model = hitchid.identify(campaign, training=None, drift=drift).model
            sys.stdout.write(f"{test.name}, drift = {drift}: {free_run_rmse(model, test):.3f} {test.unit}\n")
            sys.stdout.flush()


def last_thirds() -> None:
    """Print the errors over the last thirds of hanging-load, with two channels and with one for both."""
    (log,) = hitchid.read(DATA / "hanging-load").records
    turn = round(REVERSAL_S / log.step_s)
    training_records, test_records = [], []
    for direction, start, stop in ((LIFTING, 0, turn), (LOWERING, turn, len(log))):
        split = start + 2 * (stop - start) // 3
        training_records.append(log.slice(start, split, name=f"{direction}-early", kind=CYCLE))
        test_records.append(log.slice(split, stop, name=f"{direction}-late", kind=CYCLE))
    campaign = Campaign((*training_records, *test_records), tuple(record.name for record in test_records))
    model = hitchid.identify(campaign, training=None).model
    models = {"two channels": model}
    for direction, other in ((LIFTING, LOWERING), (LOWERING, LIFTING)):
        channel = model.channels[direction]
        mirrored = replace(channel, mode=other, direction=-channel.sign, end_stop=None)
        models[f"{direction} channel for both"] = replace(
            model, channels={direction: channel, other: mirrored}
        )
    for name, variant in models.items():
        errors = ", ".join(f"{record.name} {free_run_rmse(variant, record):.3f}" for record in test_records)
        sys.stdout.write(f"{name}: {errors} {log.unit}\n")


SETS = {"rig-a": leave_one_out, "hanging-load": last_thirds}


def main() -> None:
    """Print the figures of the sets asked for, of all by default."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", default=[], choices=[*SETS, []])
    for name in parser.parse_args().sets or SETS:
        SETS[name]()


if __name__ == "__main__":
    main()
