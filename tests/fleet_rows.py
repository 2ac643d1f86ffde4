"""Rows of made-up machines whose truth is known."""

import numpy as np

from hitchid.fleet.row import FAILED, Cost, DirectionRow, Row

STRUCTURE = "integrator-second-order: gain, frequency, damping"
UNITS = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
GAINS = {"lifting": 62.0, "lowering": 48.0}  # mm/s/A
DEAD_ZONES = {"lifting": 0.35, "lowering": 0.41}  # A
GAIN_ERROR, DEAD_ZONE_ERROR, CORRELATION = 0.01, 0.002, 0.6
GAIN_SPREAD, DEAD_ZONE_SPREAD = 0.02, 0.005  # between machines: relative, and A
COST = Cost(20.0, 30.0, 4_000_000, 300_000, 900_000_000)


def machine_name(number):
    return f"tractor-{number:02d}"


def figures(direction, rng=None, gain_factor=1.0, dead_zone_shift=0.0, **changes):
    """Return the figures of one direction, with errors and spread where there is a random generator."""
    gain, dead_zone = np.log(GAINS[direction] * gain_factor), DEAD_ZONES[direction] + dead_zone_shift
    delay = 0.08
    scatter = 0.03
    if rng is not None:
        error = rng.multivariate_normal([0, 0], [[1, CORRELATION], [CORRELATION, 1]])
        gain += GAIN_SPREAD * rng.standard_normal() + GAIN_ERROR * error[0]
        dead_zone += DEAD_ZONE_SPREAD * rng.standard_normal() + DEAD_ZONE_ERROR * error[1]
        delay += 0.005 * rng.standard_normal()
        scatter *= np.exp(0.25 * rng.standard_normal())
    values = {
        "structure": STRUCTURE,
        "gain": float(np.exp(gain)),
        "dead_zone": float(dead_zone),
        "gain_error": GAIN_ERROR,
        "dead_zone_error": DEAD_ZONE_ERROR,
        "correlation": CORRELATION,
        "delay_s": float(delay),
        "delay_error_s": 0.003,
        "load_scatter": float(scatter),
        "rmse": 0.4,
        "held_out_rmse": None,
        "tests": 9,
    }
    return DirectionRow(**(values | changes))


def row(machine, directions, date="2026-03-01T08:00:00+00:00", **changes):
    """Return the row of a machine."""
    values = {
        "machine": machine,
        "key": f"key-{machine}-{date}",
        "signature": f"signature-{machine}-{date}",
        "date": date,
        "state": "done",
        "units": UNITS,
        "directions": directions,
        "cost": COST,
    }
    return Row(**(values | changes))


def failed_row(machine, cause="InputError", message="no log has a command"):
    return row(machine, {}, state=FAILED, cause=cause, message=message, units={})


def fleet(machines=24, seed=0, faults=None, name=machine_name, directions=("lifting", "lowering")):
    """Return a row for each machine; `faults` is number of a machine to changes of its lowering."""
    rng = np.random.default_rng(seed)
    faults = faults or {}
    rows = []
    for number in range(machines):
        changes = {"lowering": faults.get(number, {})}
        own = {mode: figures(mode, rng, **changes.get(mode, {})) for mode in directions}
        rows.append(row(name(number), own))
    return rows
