"""The zoo itself: its plants against closed forms, its campaigns as files."""

import numpy as np
import pytest
from benchmarks.gauntlet.design import draw_design
from benchmarks.gauntlet.plants import (
    Plant,
    Valve,
    first_order_lag,
    integrator,
    integrator_first_order,
    integrator_second_order,
)
from benchmarks.gauntlet.zoo import draw

OPEN = (Valve(), Valve())
STAMPS = np.concatenate([[0.0], np.cumsum(np.random.default_rng(0).uniform(0.005, 0.03, 200))])
LAG, FREQUENCY, DAMPING, GAIN, LEVEL = 0.3, 7.0, 0.4, 20.0, 0.5


def second_order_step(time_s):
    """Return the displacement of K/(s (s²/ω² + 2 ξ s/ω + 1)) after a step, from tables of transforms."""
    damped = FREQUENCY * np.sqrt(1 - DAMPING**2)
    decay = np.exp(-DAMPING * FREQUENCY * time_s)
    lag = 2 * DAMPING / FREQUENCY
    swing = (1 - 2 * DAMPING**2) / damped * np.sin(damped * time_s) - lag * np.cos(damped * time_s)
    return time_s - lag - decay * swing


STEPS = {
    "integrator": (integrator, lambda t: t),
    "first-order": (
        lambda late=0.0: integrator_first_order(LAG, late),
        lambda t: t - LAG * (1 - np.exp(-t / LAG)),
    ),
    "second-order": (lambda late=0.0: integrator_second_order(FREQUENCY, DAMPING, late), second_order_step),
    "lag": (lambda late=0.0: first_order_lag(LAG, late), lambda t: LAG * (1 - np.exp(-t / LAG))),
}


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("late", [0.0, 0.137])
def test_a_plant_steps_as_its_closed_form(name, late):
    dynamics, expected = STEPS[name]
    plant = Plant(dynamics(late), OPEN, (GAIN, GAIN))
    displacement, _ = plant.run(STAMPS, np.full(STAMPS.size, LEVEL), 3.0)
    truth = 3.0 + GAIN * LEVEL * expected(np.maximum(STAMPS - late, 0.0))
    np.testing.assert_allclose(displacement, truth, atol=1e-9)


def test_an_integrator_sums_a_ramp_and_stops_at_its_end():
    command = STAMPS / STAMPS[-1]
    plant = Plant(integrator(), OPEN, (GAIN, GAIN), (-np.inf, 12.0))
    displacement, _ = plant.run(STAMPS, command, 0.0, load=0.5)
    covered = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(STAMPS))])
    np.testing.assert_allclose(displacement, np.minimum(0.5 * GAIN * covered, 12.0), atol=1e-9)


def test_a_negative_command_takes_its_own_gain_and_dead_zone():
    plant = Plant(integrator(), (Valve(), Valve(dead_zone=0.2)), (GAIN, 10.0))
    displacement, _ = plant.run(STAMPS, np.full(STAMPS.size, -LEVEL), 0.0)
    np.testing.assert_allclose(displacement, -10.0 * (LEVEL - 0.2) * STAMPS, atol=1e-9)


def test_a_valve_with_play_is_late_by_its_width():
    valve = Valve(dead_zone=0.3, play=0.1)
    spool, flows = 0.0, []
    for command in (0.5, 0.45, 0.3, 0.0):
        spool = valve.spool(spool, command)
        flows.append(valve.flow(spool))
    np.testing.assert_allclose(flows, [0.2, 0.2, 0.1, 0.0], atol=1e-12)


def test_a_controller_brings_the_plant_to_its_target():
    plant = Plant(integrator_first_order(0.05), OPEN, (1.0, 1.0))
    displacement, commands = plant.run(0.05 * np.arange(400), lambda _, y: 2.0 * (7.0 - y), 0.0)
    assert abs(displacement[-1] - 7.0) < 1e-6
    assert commands[0] == 14.0


def test_a_campaign_is_drawn_from_its_seed_alone(tmp_path):
    folders = tmp_path / "one", tmp_path / "other"
    truths = [draw(58, folder) for folder in folders]
    logs = [sorted(truth.logs.iterdir()) for truth in truths]
    assert [path.read_bytes() for path in logs[0]] == [path.read_bytes() for path in logs[1]]
    assert truths[0].values == truths[1].values
    assert truths[0].values["lifting"]["gain"] > 0


def test_the_sixty_hold_everything_the_gauntlet_is_for():
    designs = [draw_design(seed) for seed in range(60)]
    forms = {"integrator", "integrator-first-order", "integrator-second-order", "first-order-lag"}
    assert {design.structure for design in designs} == forms
    units = {"mm", "m", "cm", "deg", "rad", "V", "1"}
    assert {design.columns.displacement_unit for design in designs} == units
    shapes = {"steps", "ramp", "PRBS", "sine", "operator", "one level"}
    assert {shape for design in designs for shape in design.schedule.shapes} == shapes
    assert {design.schedule.defect for design in designs} >= {"without motion", "at the stop", "saturated"}
    assert {design.columns.layout for design in designs} >= {"signed", "two columns", "lifting", "lowering"}
    for present in (
        lambda d: d.columns.zero,
        lambda d: d.columns.scale < 0,
        lambda d: d.clock.jitter,
        lambda d: d.clock.gaps,
        lambda d: d.sensor.drift,
        lambda d: d.sensor.spikes,
        lambda d: d.sensor.quantum,
        lambda d: d.schedule.closed_loop,
        lambda d: d.schedule.scatter,
        lambda d: d.schedule.unusable,
        lambda d: d.stops,
        lambda d: d.valves[0].play,
        lambda d: d.valves[0].saturation < np.inf,
        lambda d: "dead_time" in d.values,
    ):
        assert 2 <= sum(bool(present(design)) for design in designs) <= 45
    assert sum(design.schedule.tests * design.schedule.samples for design in designs) < 1_200_000
