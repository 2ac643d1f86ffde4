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
from hitchid.data.campaign import Campaign
from hitchid.data.record import CYCLE, LIFTING, LOWERING, Record
from hitchid.model import Hitch

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
TURN_S = 186.0


def free_run_rmse(model: Hitch, record: Record) -> float:
    """Return the root mean square error of a free run, in the record's unit."""
    return float(np.sqrt(np.mean((model.simulate(record) - record.displacement) ** 2)))


def left_out() -> None:
    """Print the error on each cycle of rig-a, identified from the others, without and with creep."""
    cycles = hitchid.read(DATA / "rig-a").of_kind(CYCLE)
    for held in cycles:
        campaign = Campaign(cycles, (held.name,))
        for drift in (False, True):
            model = hitchid.identify(campaign, training=None, drift=drift).model
            sys.stdout.write(f"{held.name}, drift = {drift}: {free_run_rmse(model, held):.3f} {held.unit}\n")
            sys.stdout.flush()


def late_thirds() -> None:
    """Print the errors over the last thirds of hanging-load, with two channels and with one for both."""
    (whole,) = hitchid.read(DATA / "hanging-load").records
    turn = round(TURN_S / whole.step_s)
    early, late = [], []
    for mode, start, stop in ((LIFTING, 0, turn), (LOWERING, turn, len(whole))):
        cut = start + 2 * (stop - start) // 3
        early.append(whole.slice(start, cut, name=f"{mode}-early", kind=CYCLE))
        late.append(whole.slice(cut, stop, name=f"{mode}-late", kind=CYCLE))
    campaign = Campaign((*early, *late), tuple(record.name for record in late))
    model = hitchid.identify(campaign, training=None).model
    models = {"two channels": model}
    for mode, other in ((LIFTING, LOWERING), (LOWERING, LIFTING)):
        channel = model.channels[mode]
        mirrored = replace(channel, mode=other, direction=-channel.direction, end_stop=None)
        models[f"{mode} channel for both"] = replace(model, channels={mode: channel, other: mirrored})
    for name, each in models.items():
        errors = ", ".join(f"{record.name} {free_run_rmse(each, record):.3f}" for record in late)
        sys.stdout.write(f"{name}: {errors} {whole.unit}\n")


SETS = {"rig-a": left_out, "hanging-load": late_thirds}


def main() -> None:
    """Print the figures of the sets asked for, of all by default."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", default=[], choices=[*SETS, []])
    for name in parser.parse_args().sets or SETS:
        SETS[name]()


if __name__ == "__main__":
    main()
