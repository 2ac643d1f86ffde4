"""From records that hold and move in turn: how fast a held piston creeps, and which hitch errs less."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, hitch
from hitchid import identify
from hitchid.identification.campaign_job import cycle_errors, without_speed_compensators
from hitchid.identification.hold_drift import SETTLED_S, SHORTEST_S, drift_is_shown, hold_drift, holds
from hitchid.logs.campaign import Campaign
from hitchid.model import TravelLimits
from hitchid.structures import ModelSpec, structure_named
from truth import held as response

STEP_S = 0.01
SETTLED, SHORTEST = round(SETTLED_S / STEP_S), round(SHORTEST_S / STEP_S)
CREEP, NOISE = -0.4, 0.02
GAIN, LAG_S = 60.0, 0.12  # mm/(s·A), s


@pytest.fixture
def held(make_record):
    """Return a function that makes a piston creep where no valve is on; elsewhere it moves."""

    def make(*levels, creep=CREEP, noise=0.0, seed=0):
        sizes, ups, downs = zip(*levels, strict=True)
        up, down = np.repeat([ups, downs], sizes, axis=1).astype(float)
        idle = (up <= DEAD_ZONES["lifting"]) & (down <= DEAD_ZONES["lowering"])
        speed = np.where(idle, creep, 20 * up - 30 * down)
        errors = noise * np.random.default_rng(seed).standard_normal(up.size)
        return make_record(100 + STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]]) + errors, up, down)

    return make


CYCLE = ((200, 0, 0), (100, 0.6, 0), (150, 0.2, 0.1), (100, 0, 0.5), (250, 0, 0))


def test_the_creep_is_found_within_its_standard_error(held):
    assert hold_drift(holds([held(*CYCLE)], DEAD_ZONES)) == pytest.approx(CREEP, rel=1e-9)
    records = [held(*CYCLE, noise=NOISE, seed=seed) for seed in range(4)]
    settled = [samples - SETTLED for samples, up, down in CYCLE if max(up - 0.2, down - 0.1) <= 0]
    # The variance of a slope through n samples of noise σ is σ² / Σ(t − t̄)², and Σ = h² (n³ − n) / 12.
    spread = len(records) * STEP_S**2 * sum(n**3 - n for n in settled) / 12
    assert abs(hold_drift(holds(records, DEAD_ZONES)) - CREEP) < 4 * NOISE / np.sqrt(spread)


def test_nothing_held_creeps_not(held):
    assert hold_drift(holds([held((300, 0.6, 0), (300, 0, 0.6))], DEAD_ZONES)) == 0.0
    assert hold_drift([]) == 0.0


def test_what_is_held_too_briefly_is_left_out(held):
    long_enough = SETTLED + SHORTEST
    for samples, expected in ((long_enough - 1, 0.0), (long_enough, CREEP)):
        creep = hold_drift(holds([held((100, 0.6, 0), (samples, 0, 0), (100, 0.6, 0))], DEAD_ZONES))
        assert creep == pytest.approx(expected, rel=1e-9)


def test_half_a_second_after_a_stroke_is_left_out(make_record):
    up = np.concatenate([np.full(100, 0.6), np.zeros(200)])
    settling = np.concatenate([np.linspace(0, 5, 100 + SETTLED), np.full(200 - SETTLED, 5.0)])
    assert hold_drift(holds([make_record(settling, up, 0 * up)], DEAD_ZONES)) == pytest.approx(0.0, abs=1e-12)


def test_a_piston_on_its_stop_says_nothing_of_creep(held):
    record = held(*CYCLE)
    stop = TravelLimits(float(record.displacement[:200].mean()), 200.0, lower_stop=True)
    assert len(holds([record], DEAD_ZONES, stop)[0]) == len(holds([record], DEAD_ZONES)[0]) - 1


@pytest.mark.parametrize("logs", [1, 4])
@pytest.mark.parametrize(
    ("creeps", "shown"), [((CREEP,) * 4, True), ((0.0,) * 4, False), ((-1, 1, -1, 1), False)]
)
def test_a_creep_is_shown_where_the_others_have_it(held, logs, creeps, shown):
    records = [held(*CYCLE, creep=creep, noise=NOISE, seed=n) for n, creep in enumerate(creeps[:logs])]
    assert drift_is_shown(holds(records, DEAD_ZONES)) is (shown or (logs == 1 and creeps[0] != 0))


def test_nothing_held_shows_no_creep(held):
    assert not drift_is_shown([])
    assert not drift_is_shown(holds([held((300, 0.6, 0), (300, 0, 0.6))], DEAD_ZONES))


@pytest.mark.long
@pytest.mark.parametrize("creep", [CREEP, 0.0])
def test_mixed_logs_that_creep_give_a_model_that_does(make_record, creep):
    rng, logs = np.random.default_rng(0), []
    for number in range(4):
        sizes = rng.integers([50, 60, 150, 60, 150, 60, 150], [60, 120, 250, 120, 250, 120, 250])
        signed = np.repeat([0.0, 0.7, 0.0, -0.6, 0.0, 0.9, 0.0], sizes)
        travel = response([GAIN], [LAG_S, 1.0, 0.0], signed, STEP_S) + creep * np.cumsum(signed == 0) * STEP_S
        noise = NOISE * rng.standard_normal(signed.size)
        up, down = np.maximum(signed, 0.0), np.maximum(-signed, 0.0)
        logs.append(make_record(100 + travel + noise, up, down, name=f"log-{number}"))
    form, none = ModelSpec(structure_named("integrator-first-order")), {"lifting": 0.0, "lowering": 0.0}
    model = identify(
        Campaign.of(logs),
        structure=form,
        dead_zones=none,
        training=None,
        rivals=None,
    ).model
    # Four logs of three holds each; what is left of e⁻⁵ of a speed of some 50 mm/s fades within the holds.
    assert model.drift == pytest.approx(creep, abs=0.05)
    assert (model.drift == 0.0) is (creep == 0.0)


@pytest.mark.parametrize("compensated", [True, False])
def test_the_hitch_that_made_a_cycle_has_no_error(make_record, compensated):
    """Compensators for free run are judged on whole cycles too."""
    up, down = np.repeat([[0, 0.8, 0, 0, 0.7, 0], [0, 0, 0, 0.8, 0, 0]], 60, axis=1)
    commands = make_record(np.full(up.size, 80.0), up, down)
    model = hitch(free_run=True)
    maker = model if compensated else without_speed_compensators(model)
    displacement = np.asarray(maker.simulate(commands).displacement)
    cycle = replace(commands, signals={**commands.signals, "displacement": displacement})
    right, wrong = cycle_errors(model, [cycle])[:: 1 if compensated else -1]
    assert right == pytest.approx(0.0, abs=1e-9)
    assert wrong > 0.1
