"""What the tests covered: trusted within, not trusted a tenth of the range beyond."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handmade import envelope
from hitchid.identification.direction import operating_range_of
from hitchid.logs.record import LIFTING
from hitchid.networks.operating_range import SignalRange
from hitchid.structures import Batch

EPS = np.finfo(np.float64).eps
ends = st.tuples(st.floats(-1e3, 1e3), st.floats(0.1, 1e3))


def trusted(lowest, highest, values):
    return np.asarray(SignalRange(jnp.asarray(lowest), jnp.asarray(highest)).trust(jnp.asarray(values)))


@given(ends=ends, share=st.floats(0.0, 1.0))
def test_trust_falls_to_zero_over_a_tenth_beyond_the_range(ends, share):
    lowest, width = ends
    highest = lowest + width
    inside = lowest + share * (highest - lowest)
    assert trusted(lowest, highest, np.clip(inside, lowest, highest)) == 1.0
    # Ends of 1000 and a tenth of 0.1: what rounding makes of the place within the margin.
    rounding = 4 * EPS * 2e3 / (0.1 * width)
    for beyond in (lowest - 0.1 * width * share, highest + 0.1 * width * share):
        assert trusted(lowest, highest, beyond) == pytest.approx(1 - share, abs=rounding)
    for far in (lowest - 0.11 * width, highest + 0.11 * width, -1e9, 1e9):
        assert trusted(lowest, highest, far) == 0.0


@given(ends=ends)
def test_trust_never_grows_on_the_way_out(ends):
    lowest, width = ends
    way = np.linspace(lowest + width / 2, lowest + 1.5 * width, 60)
    found = trusted(lowest, lowest + width, way)
    assert np.all(np.diff(found) <= 0.0)
    assert (found[0], found[-1]) == (1.0, 0.0)


def test_the_range_of_a_missing_load_is_never_left():
    assert trusted(0.0, 0.0, 0.0) == 1.0
    covered = envelope()
    assert float(covered.trust(jnp.asarray(0.2), jnp.asarray(80.0), jnp.zeros(1))) == 1.0


def test_one_range_left_by_a_tenth_is_enough():
    covered = envelope(load=(10.0, 20.0))
    within = {"command": 0.2, "displacement": 80.0, "load": [15.0]}
    beyond = {"command": 0.56, "displacement": 161.0, "load": [21.5]}
    halfway = {"command": 0.525, "displacement": 155.0, "load": [20.5]}
    assert float(covered.trust(*map(jnp.asarray, within.values()))) == 1.0
    for name in within:
        for values, trust in ((beyond, 0.0), (halfway, 0.5)):
            given_values = {**within, name: values[name]}
            found = covered.trust(*map(jnp.asarray, given_values.values()))
            assert float(found) == pytest.approx(trust, abs=1e-12)


def test_the_ranges_are_those_of_the_samples_that_count(make_record):
    records = [
        make_record(np.linspace(start, start + 10.0, 100), np.linspace(0.0, top, 100))
        for start, top in ((80.0, 0.7), (70.0, 0.9))
    ]
    batch = Batch.of(records, LIFTING, dead_zone=0.3, sign=1)
    found = operating_range_of(batch, ())
    ranges = {name: (ends.lowest.item(), ends.highest.item()) for name, ends in vars(found).items()}
    assert ranges["command"] == pytest.approx((0.0, 0.6))
    assert ranges["displacement"] == (70.0, 90.0)
    assert ranges["load"] == (0.0, 0.0)
    early = batch.masked(jnp.asarray(np.arange(batch.command.shape[1]) < 50)[None] & batch.loss_mask)
    assert float(operating_range_of(early, ()).displacement.highest) == records[0].displacement[49]
    assert float(operating_range_of(early, ()).command.highest) == pytest.approx(0.9 * 49 / 99 - 0.3)
