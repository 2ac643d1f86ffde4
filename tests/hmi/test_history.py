"""What pages are sent: of a long window lowest and highest remain; and which of them is the operator's."""

import asyncio
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.hmi import recorder as module
from hitchid.hmi.clients import MOST_TEXTS, MOST_WAITING, Client, Clients
from hitchid.hmi.recorder import History, SpeedEstimate, block_of, packed_rows

STEP_S = 0.01


def filled(count, columns=3, *, kept=None, blocks=7):
    """Return a history of random samples that came in blocks, and all samples."""
    rng = np.random.default_rng(count)
    rows = np.column_stack([STEP_S * np.arange(count), rng.normal(size=(count, columns - 1))])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "HISTORY_S", STEP_S * (kept or count + 1))
        history = History(columns, STEP_S)
    for start in range(0, count, blocks):
        history.append(rows[start : start + blocks])
    return history, rows


def test_a_short_window_is_every_sample():
    history, rows = filled(500)
    np.testing.assert_array_equal(history.decimated(1.0, 2.0, 1000), rows[100:201])
    assert history.decimated(50.0, 60.0, 10).shape == (0, 3)
    assert History(3, STEP_S).decimated(0.0, 1.0, 10).shape == (0, 3)


@given(st.integers(1, 3000), st.integers(2, 300))
def test_a_long_window_keeps_lowest_and_highest_in_few_rows(count, points):
    history, rows = filled(count)
    shown = history.decimated(-1.0, 1e9, points)
    assert len(shown) <= max(points, 2)
    np.testing.assert_array_equal(shown[:, 1:].min(axis=0), rows[:, 1:].min(axis=0))
    np.testing.assert_array_equal(shown[:, 1:].max(axis=0), rows[:, 1:].max(axis=0))
    assert np.all(np.diff(shown[:, 0]) >= 0)
    assert (shown[0, 0], shown[-1, 0]) == (rows[0, 0], rows[-1, 0])


@pytest.mark.parametrize(("kept", "blocks"), [(100, 7), (101, 7), (350, 7), (64, 1000)])
def test_only_the_newest_samples_are_kept_in_their_order(kept, blocks):
    history, rows = filled(1000, kept=kept, blocks=blocks)
    np.testing.assert_array_equal(history.decimated(-1.0, 1e9, 10_000), rows[-kept:])


def test_missing_values_stay_missing_only_where_a_bin_has_none():
    rows = np.column_stack([STEP_S * np.arange(10, 110), np.full(100, np.nan)])
    rows[3, 1] = 9.0
    history = History(2, STEP_S)
    history.append(rows)
    shown = history.decimated(0.0, 1e9, 20)
    np.testing.assert_array_equal(shown[:2, 1], [9.0, 9.0])
    assert np.isnan(shown[2:, 1]).all()


def test_messages_are_laid_out_as_page_and_server_read_them():
    rows = np.array([[1.0, 2.0, np.nan], [3.0, 4.0, 5.0]])
    message = packed_rows(2, rows, 1.5e12)
    assert struct.unpack_from("<4I", message) == (2, 2, 3, 0)
    assert struct.unpack_from("<d", message, 16) == (1.5e12,)
    assert struct.unpack_from("<3d", message, 24 + 24) == (3.0, 4.0, 5.0)
    assert len(message) == 24 + 6 * 8
    wall_ms, block = block_of(np.array([7.0, 3.0]).tobytes() + rows.tobytes())
    assert wall_ms == 7.0
    np.testing.assert_array_equal(block, rows)


def test_the_first_page_is_the_operator():
    clients = Clients()
    first, second = clients.add("a"), clients.add("b")
    assert clients.operator == first.name
    assert not clients.claim(second)
    assert clients.claim(first)
    clients.release(second)
    assert clients.operator == first.name
    clients.release(first)
    assert clients.operator is None
    assert clients.claim(second)
    clients.remove(second)
    assert (clients.operator, len(clients)) == (None, 1)
    assert clients.claim(first)


@given(st.lists(st.tuples(st.sampled_from(["add", "remove", "claim", "release"]), st.integers(0, 5))))
def test_there_is_at_most_one_operator_and_it_is_connected(events):
    clients = Clients()
    for event, number in events:
        connected = list(clients)
        if event == "add":
            clients.add("a")
        elif connected:
            getattr(clients, event)(connected[number % len(connected)])
        assert clients.operator is None or clients.operator in {client.name for client in clients}


def test_a_page_that_does_not_read_costs_few_messages():
    async def main():
        client = Client("a")
        for k in range(10 * MOST_WAITING):
            client.put({"number": k})
            client.put(b"%d" % k)
        client.put({"type": "last"})
        texts = [await client.next() for _ in range(MOST_TEXTS)]
        return texts, [await client.next() for _ in range(MOST_WAITING)]

    texts, frames = asyncio.run(main())
    assert texts[-1] == '{"type": "last"}'
    assert [int(frame) for frame in frames] == list(range(9 * MOST_WAITING, 10 * MOST_WAITING))


def test_the_speed_is_that_of_a_steady_motion():
    times_s = 0.01 * np.arange(100)
    rows = np.column_stack([times_s, np.zeros((100, 2)), np.maximum(times_s - 0.5, 0) * 30.0])
    estimate = SpeedEstimate(3, 0.01)
    speeds = np.concatenate([estimate.advance(rows[k : k + 7]) for k in range(0, 100, 7)])
    np.testing.assert_allclose(speeds[:51], 0)
    np.testing.assert_allclose(speeds[61:], 30.0, rtol=1e-9)
