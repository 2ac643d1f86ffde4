"""Compensators for free run are judged on whole cycles too."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import STEP_S, hitch
from hitchid.identification.campaign_job import cycle_errors, without_speed_compensators
from hitchid.logs.record import Record


@pytest.fixture(scope="module")
def cycle():
    """Return a record of both directions in turn, at the displacement 80 mm throughout."""
    up = np.repeat([0.0, 0.8, 0.0, 0.0, 0.7, 0.0], 60)
    down = np.repeat([0.0, 0.0, 0.0, 0.8, 0.0, 0.0], 60)
    signals = {"displacement": np.full(up.size, 80.0), "lifting_command": up, "lowering_command": down}
    units = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    return Record("cycle", STEP_S, signals, units, kind="cycle")


def measured_by(simulated, record):
    displacement = np.asarray(simulated.simulate(record).displacement)
    return replace(record, signals={**record.signals, "displacement": displacement})


def test_of_two_hitches_the_one_that_made_the_cycle_has_no_error(cycle):
    compensated = hitch(free_run=True)
    plain = without_speed_compensators(compensated)
    with_it, without_it = cycle_errors(compensated, [measured_by(plain, cycle)])
    assert without_it == pytest.approx(0.0, abs=1e-9)
    assert with_it > 0.1
    with_it, without_it = cycle_errors(compensated, [measured_by(compensated, cycle)])
    assert with_it == pytest.approx(0.0, abs=1e-9)
    assert without_it > 0.1
