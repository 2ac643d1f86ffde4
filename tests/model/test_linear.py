"""Hand-over to scipy and python-control: steps of 60 s in a process without x64 against simulation."""

import json
import subprocess
import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import save
from hitchid.structures import PhysicalModel, structure_named

CHILD = """
import json, sys
from dataclasses import replace
from pathlib import Path
import jax
import numpy as np
from scipy import signal
import hitchid

assert not jax.config.jax_enable_x64
LENGTH_S = 60.0


def simulated(model, direction, command):
    n = command.size
    signals = {"displacement": np.full(n, 100.0), f"{direction}_command": command}
    if model.channels[direction].benchmark.covariates:
        signals["pressure"] = np.full(n, 120.0)
    units = {role: model.units[role] for role in signals}
    return np.asarray(model.simulate(hitchid.Record("step", model.step_s, signals, units), compensated=False))


def stepped(model, low, high):
    # One sample of rest, which gives the initial displacement.
    n = round(LENGTH_S / model.step_s)
    command = np.full(n, high)
    command[0] = 0.0
    command[1 : n // 6] = low
    return command


def linear_error(model, direction):
    system = model.to_scipy(direction, model.step_s)
    dead_zone = model.channels[direction].dead_zone
    command = stepped(model, dead_zone + 0.1, dead_zone + 0.2)
    _, found, _ = signal.dlsim(system, np.maximum(command - dead_zone, 0.0))
    expected = simulated(model, direction, command) - 100.0
    return float(np.max(np.abs(found.ravel() - expected)) / np.max(np.abs(expected)))


def operating_error(model, direction, size):
    base = model.channels[direction].dead_zone + 0.3
    low, high = stepped(model, base, base), stepped(model, base, base + size)
    system = model.to_control(direction, model.step_s, command=base, displacement=100.0, load=120.0)
    _, found, _ = signal.dlsim((system.A, system.B, system.C, system.D, system.dt), high - low)
    expected = simulated(model, direction, high) - simulated(model, direction, low)
    return float(np.max(np.abs(found.ravel() - expected)) / np.max(np.abs(expected)))


errors = {}
for path in sorted(Path(sys.argv[1]).iterdir()):
    original = hitchid.load(path)
    for step_s in (0.001, 0.01):
        model = replace(original, step_s=step_s)
        for direction in model.channels:
            key = f"{path.name} {direction} {step_s}"
            if path.name == "curved":
                errors[key] = [operating_error(model, direction, size) for size in (2e-3, 1e-3, 5e-4)]
            else:
                errors[key] = linear_error(model, direction)
print(json.dumps(errors))
"""
STRUCTURES = ("integrator", "first-order-lag", "integrator-first-order", "integrator-second-order")
SLOW = 1e-4  # factor on the gain, such that 60 s of motion are a small part of the stroke


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """Return the relative errors of a fresh process, model, direction and sampling time to error."""
    folder = tmp_path_factory.mktemp("linear")
    for structure in STRUCTURES:
        for dead_time_s in (0.0, 0.0374):
            save(handmade.hitch(structure, dead_time_s=dead_time_s), folder / f"{structure}-{dead_time_s}")
    curved = handmade.hitch_of(
        handmade.channel(LIFTING, "integrator-second-order", dead_time_s=0.0374, shape=True)
    )
    save(curved.with_parameters(lifting={"gain": SLOW * handmade.GAINS[LIFTING]}), folder / "curved")
    done = subprocess.run([sys.executable, "-c", CHILD, str(folder)], capture_output=True, text=True)  # noqa: S603
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.long
def test_a_step_of_60_s_agrees_with_the_simulation(errors):
    linear = {key: error for key, error in errors.items() if not key.startswith("curved")}
    assert len(linear) == 2 * 2 * 2 * len(STRUCTURES)
    assert {key: error for key, error in linear.items() if not error <= 1e-6} == {}


@pytest.mark.long
def test_a_small_step_about_an_operating_point_agrees_to_the_order_of_its_size(errors):
    curved = {key: np.array(error) for key, error in errors.items() if key.startswith("curved")}
    assert len(curved) == 2
    # The operating point in shares of U = 1.2 A beyond the opening d = 0.1, at mean load (120 bar), with
    # exponent n = 1.5 and saturation σ = 2: v = a^n, w = v (1 + (v/σ)⁴)^(-1/4).
    above_opening = 0.3 / 1.2 - 0.1
    for found in curved.values():
        sizes = np.array([2e-3, 1e-3, 5e-4]) / 1.2
        # w''/(2 w') = (n − 1)/(2 a); saturation and higher orders change it by less than a tenth.
        curvature = 0.5 / (2 * above_opening) * sizes
        # The nominal motion of 60 s, and the gain's change along it: |d ln g/dξ| ≤ 0.2 + 2·0.1·|ξ| < 0.21 at
        # mid stroke, ξ within 60 s K w g/span with g < 1.1.
        travel = 60 * SLOW * 30.0 * 1.2 * above_opening**1.5 * 1.1
        drift = 0.21 * travel / 60.0
        assert np.all(found <= 1.1 * curvature + drift)
        # Halved step, halved error beyond that of the stroke, which is the same.
        assert np.all(np.abs(np.diff(found)) >= 0.5 * np.abs(np.diff(curvature)))


def test_lowering_falls():
    model = handmade.hitch("integrator-first-order")
    assert model.to_scipy(LIFTING, 0.01).C[0, 0] == 1.0
    assert model.to_scipy(LOWERING, 0.01).C[0, 0] == -1.0


def test_the_continuous_model_with_a_spool_is_the_limit_of_the_discrete_one():
    model = handmade.hitch_of(handmade.channel(LIFTING, "integrator-first-order", shape=True))
    point = {"command": 0.8, "displacement": 90.0, "load": 130.0}
    continuous = model.to_scipy(step_s=None, **point)
    step_s = 1e-5
    fine = model.to_scipy(step_s=step_s, **point)
    for omega in (0.5, 5.0, 50.0):
        s, z = 1j * omega, np.exp(1j * omega * step_s)
        exact, found = (
            (system.C @ np.linalg.solve(at * np.eye(len(system.A)) - system.A, system.B)).item()
            for system, at in ((continuous, s), (fine, z))
        )
        # A held command and a held flow are late by half a sample each: ω h/2 of phase each.
        assert abs(found / exact - 1) <= 1.1 * omega * step_s


def test_nonlinear_structures_and_closed_valves_are_refused():
    model = handmade.hitch(shape=True)
    with pytest.raises(InputError, match=r"beyond the dead zone, where the valve opens; got 0\.05"):
        model.to_control(LIFTING, 0.01, command=handmade.DEAD_ZONES[LIFTING] + 0.05)
    with pytest.raises(InputError, match=r"beyond the dead zone of 0.35, got 0.3"):
        model.to_control(LIFTING, 0.01, command=0.3)
    with pytest.raises(InputError, match="direction: expected one of lifting, lowering"):
        model.to_control(step_s=0.01)
    with pytest.raises(InputError, match=r"nonlinear structure 'cascaded-tanks'.*use `simulate`"):
        tanks().to_control(step_s=0.01)
    for call in (lambda: tanks().speed(1.0), lambda: tanks().inverse_table()):
        with pytest.raises(InputError, match=r"nonlinear structure 'cascaded-tanks'.*constant command"):
            call()


def tanks():
    """Return a model of one channel with a nonlinear structure."""
    channel = handmade.channel(LIFTING)
    structure = structure_named("cascaded-tanks")
    benchmark = PhysicalModel(structure, jnp.ones(len(structure.parameters)), jnp.zeros(()))
    return handmade.hitch_of(replace(channel, benchmark=benchmark))


def test_the_default_operating_point_is_open_for_any_opening():
    channel = handmade.channel(LIFTING, shape=True)
    curves = channel.benchmark.nonlinearity
    late = replace(curves, values=curves.values.at[0].set(0.9))
    model = handmade.hitch_of(replace(channel, benchmark=replace(channel.benchmark, nonlinearity=late)))
    command = handmade.DEAD_ZONES[LIFTING] + 1.2 * (0.9 + 1) / 2
    at = {"command": command, "displacement": 100.0, "load": 120.0}
    np.testing.assert_allclose(model.to_scipy(step_s=0.01).C, model.to_scipy(step_s=0.01, **at).C, rtol=1e-14)
