"""Test signals against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.bench import excitation
from hitchid.errors import InputError


def test_a_ramp_rises_evenly_from_zero_to_its_top():
    command = excitation.ramp(top=0.6, duration_s=30.0)
    assert command[0] == 0.0
    assert (command[-1], command.size) == (0.6, 3001)
    # Equal steps up to the rounding of linspace.
    np.testing.assert_allclose(np.diff(command), 0.6 / 3000, rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), clock=st.sampled_from([0.05, 0.1, 0.25]))
def test_a_prbs_holds_two_levels_for_whole_clocks(seed, clock):
    command = excitation.prbs(low=0.1, high=0.3, clock_s=clock, duration_s=10.0, seed=seed)
    assert np.all(command[:5] == 0.0)
    assert set(np.unique(command[5:])) <= {0.1, 0.3}
    switches = np.flatnonzero(np.diff(command[5:])) + 1
    assert np.all(switches % round(clock / 0.01) == 0)


def test_a_period_of_a_prbs_is_balanced():
    # 127 clocks of 0.01 s after the rest: one period of a 7-bit register has 64 high and 63 low clocks.
    command = excitation.prbs(low=0.0, high=1.0, clock_s=0.01, duration_s=1.31, seed=3)[5:]
    assert command.size == 127
    assert command.sum() in (63.0, 64.0)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_duty_cycle_commands_one_way_within_its_range(seed):
    up, down = excitation.duty_cycle(
        levels=((0.05, 0.3), (0.05, 0.3)),
        speeds=(40.0, 20.0),
        start=125.0,
        displacement_range=(40.0, 210.0),
        duration_s=60.0,
        seed=seed,
    )
    assert not np.any((up > 0) & (down > 0))
    height = 125.0 + 0.01 * np.cumsum(40.0 * up - 20.0 * down)
    # Strokes end on whole samples: at most half a sample of the fastest speed is gained each, 200 strokes.
    assert height.min() > 40.0 - 200 * 0.005 * 12.0
    assert height.max() < 210.0 + 200 * 0.005 * 12.0


def test_precompensation_adds_the_dead_zone_only_where_something_is_commanded():
    command = excitation.precompensated(np.array([0.0, 0.1, 0.2]), 0.35)
    np.testing.assert_array_equal(command, [0.0, 0.1 + 0.35, 0.2 + 0.35])


def test_levels_the_wrong_way_round_are_refused():
    with pytest.raises(InputError, match=r"0 ≤ low < high, got 0.3 and 0.1"):
        excitation.prbs(low=0.3, high=0.1, clock_s=0.1, duration_s=10.0, seed=0)
