"""How fast a held piston creeps, from records that hold and move in turn."""

import numpy as np
import pytest

from handmade import DEAD_ZONES
from hitchid.identification.campaign_job import SETTLED_S, SHORTEST_S, hold_drift

STEP_S = 0.01
SETTLED, SHORTEST = round(SETTLED_S / STEP_S), round(SHORTEST_S / STEP_S)
CREEP, NOISE = -0.4, 0.02


@pytest.fixture
def held(make_record):
    """Return a function that makes a piston creep where no valve is on; elsewhere it moves."""

    def make(*levels, creep=CREEP, noise=0.0, seed=0):
        up, down = (np.concatenate([np.full(each[0], float(each[n])) for each in levels]) for n in (1, 2))
        idle = (up <= DEAD_ZONES["lifting"]) & (down <= DEAD_ZONES["lowering"])
        speed = np.where(idle, creep, 20 * up - 30 * down)
        errors = noise * np.random.default_rng(seed).standard_normal(up.size)
        return make_record(100 + STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]]) + errors, up, down)

    return make


CYCLE = ((200, 0, 0), (100, 0.6, 0), (150, 0.2, 0.1), (100, 0, 0.5), (250, 0, 0))


def test_the_creep_is_found_exactly_without_noise(held):
    assert hold_drift([held(*CYCLE)], DEAD_ZONES) == pytest.approx(CREEP, rel=1e-9)


def test_the_creep_is_found_within_its_standard_error(held):
    records = [held(*CYCLE, noise=NOISE, seed=seed) for seed in range(4)]
    settled = [samples - SETTLED for samples, up, down in CYCLE if max(up - 0.2, down - 0.1) <= 0]
    # The variance of a slope through n samples of noise σ is σ² / Σ(t − t̄)², and Σ = h² (n³ − n) / 12.
    spread = len(records) * STEP_S**2 * sum(n**3 - n for n in settled) / 12
    assert abs(hold_drift(records, DEAD_ZONES) - CREEP) < 4 * NOISE / np.sqrt(spread)


def test_nothing_held_creeps_not(held):
    assert hold_drift([held((300, 0.6, 0), (300, 0, 0.6))], DEAD_ZONES) == 0.0
    assert hold_drift([], DEAD_ZONES) == 0.0


def test_what_is_held_too_briefly_is_left_out(held):
    long_enough = SETTLED + SHORTEST
    for samples, expected in ((long_enough - 1, 0.0), (long_enough, CREEP)):
        found = hold_drift([held((100, 0.6, 0), (samples, 0, 0), (100, 0.6, 0))], DEAD_ZONES)
        assert found == pytest.approx(expected, rel=1e-9)


def test_half_a_second_after_a_stroke_is_left_out(make_record):
    up = np.concatenate([np.full(100, 0.6), np.zeros(200)])
    settling = np.concatenate([np.linspace(0, 5, 100 + SETTLED), np.full(200 - SETTLED, 5.0)])
    assert hold_drift([make_record(settling, up, 0 * up)], DEAD_ZONES) == pytest.approx(0.0, abs=1e-12)


def test_every_stretch_has_a_level_of_its_own(held):
    low, high = held(*CYCLE, creep=0.0), held(*CYCLE, creep=0.0)
    assert hold_drift([low, high], DEAD_ZONES) == pytest.approx(0.0, abs=1e-12)
