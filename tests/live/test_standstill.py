"""Standstill between strokes: its leak against a known one, jumps as faults."""

import math

import numpy as np
import pytest

import machine
from hitchid.live import AdaptationSettings, Adapter
from hitchid.live.events import FAULT, LEARNED, REFUSED
from hitchid.live.gates import SHORTEST_S, rested_at, standstill_before
from hitchid.logs.record import LOWERING
from machine import MODEL, NOISE, STEP_S


def strokes_apart(seconds, change, seed=1):
    """Return two strokes with a standstill of so many seconds between them, over which the piston moves."""
    first = machine.stroke(seed=seed)
    start = 100.0 + float(machine.stroke().displacement[-1] - 100.0) + change
    second = machine.stroke(LOWERING, start=start, seed=seed + 1, begin=first.end + round(seconds / STEP_S))
    return first, second


def standstill(seconds, change, seed=1):
    first, second = strokes_apart(seconds, change, seed)
    return standstill_before(MODEL, second, first.end, rested_at(first, STEP_S))


@pytest.mark.parametrize("seconds", [SHORTEST_S, 600.0, 36_000.0])
def test_the_leak_is_that_of_the_machine_within_its_deviation(seconds):
    leaks = [standstill(seconds, -3.0, seed).leak for seed in range(0, 100, 2)]
    errors = [(each["leak"] + 3.0 / seconds) / each["leak_deviation"] for each in leaks]
    assert np.max(np.abs(errors)) < 4
    assert leaks[0]["leak_deviation"] == pytest.approx(leaks[-1]["leak_deviation"])


def test_a_short_standstill_shows_no_leak():
    assert standstill(0.9 * SHORTEST_S, -3.0).leak == {}


def test_one_sample_that_is_wrong_makes_no_leak():
    first, second = strokes_apart(60.0, 0.0)
    first.displacement[-3] += 40.0
    second.displacement[second.rest - 4] -= 40.0
    found = standstill_before(MODEL, second, first.end, rested_at(first, STEP_S))
    assert abs(found.change) < 4 * NOISE


@pytest.mark.parametrize(("change", "is_fault"), [(10.0, True), (-10.0, True), (0.5, False), (0.0, False)])
def test_a_jump_is_a_fault_and_no_leak(change, is_fault):
    adapter, (first, second) = Adapter(MODEL, AdaptationSettings()), strokes_apart(20.0, change)
    state, _ = adapter.learn(adapter.initial_state(), first)
    _, events = adapter.learn(state, second)
    judged = next(event for event in events if event.kind in (LEARNED, REFUSED))
    assert (FAULT in {event.kind for event in events}) == is_fault
    assert ("leak" in judged.figures) != is_fault


def test_what_was_not_seen_is_no_standstill():
    first, second = strokes_apart(60.0, 0.0)
    assert standstill_before(MODEL, second, first.end, math.nan) is None
    assert math.isnan(
        rested_at(first._replace(displacement=np.full(len(first.displacement), np.nan)), STEP_S)
    )
