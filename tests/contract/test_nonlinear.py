"""One protocol over every nonlinear benchmark structure, and the closed forms of each."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.logs.record import LIFTING
from hitchid.structures import (
    BUILT_IN,
    Batch,
    CovariateEffects,
    ModelSpec,
    PhysicalModel,
    linearise,
    structure_named,
)
from hitchid.structures.nonlinear_structures import (
    EMPTY,
    LOWER_BRIM,
    SIGN_SMOOTHING,
    NonlinearStructure,
    simulate_nonlinear,
)
from truth import STEP_S, held, levels

EPS = np.finfo(np.float64).eps
SAMPLES = 200
# An axis whose viscous and Coulomb friction are equal at 6 mm/s, moving at 40 mm/s; tanks half full.
AXIS = {
    "gain": 30.0,
    "viscous_friction": 2.0,
    "coulomb_friction": 0.4,
    "offset": 0.05,
    "asymmetry": 0.3,
    "static_friction": 0.04,
    "offset_per_travel": 0.002,
    "initial_speed": 40.0,
}
TANKS = {
    "inflow": 0.01,
    "upper_outflow": 0.03,
    "transfer": 0.035,
    "lower_outflow": 0.04,
    "outflow_correction": 0.002,
    "spill": 0.7,
    "initial_upper_level": 0.5,
    "brim": 10.0,
}
TYPICAL = {"inertia-with-friction": (AXIS, 5.0), "cascaded-tanks": (TANKS, 4.0)}
NONLINEAR = {structure.name: structure for structure in BUILT_IN if isinstance(structure, NonlinearStructure)}

every_nonlinear_structure = pytest.mark.parametrize("structure", NONLINEAR.values(), ids=NONLINEAR.keys())


def values_of(structure, **changed):
    """Return the typical values of a structure, some of them changed."""
    named, _ = TYPICAL[structure.name]
    return jnp.array([{**named, **changed}[parameter.name] for parameter in structure.parameters])


def displacement(structure, command, *, initial=None, step_s=STEP_S, **changed):
    """Return the displacement of one test, shape [N]."""
    start = TYPICAL[structure.name][1] if initial is None else initial
    rows = simulate_nonlinear(
        structure, values_of(structure, **changed), jnp.asarray(command)[None], jnp.array([start]), step_s
    )
    return np.asarray(rows)[0]


def in_substeps(structure, count):
    """Return a structure of the same equations in another number of steps a sample."""
    return type(f"In{count}Steps", (type(structure),), {"substeps": count})()


@every_nonlinear_structure
def test_integration_converges_by_the_fourth_order(structure):
    # Smooth where nothing turns round, stands still or overflows; a hundredth of the fastest time constant
    # would leave nothing but rounding.
    step_s = {"inertia-with-friction": 0.2, "cascaded-tanks": 20.0}[structure.name]
    command = 2.0 + 0.3 * np.sin(np.arange(12.0))
    runs = [displacement(in_substeps(structure, n), command, step_s=step_s) for n in (2, 4, 8)]
    coarse, fine = (np.abs(one - other).max() for one, other in pairwise(runs))
    assert fine > 1e4 * EPS * np.abs(runs[0]).max()
    # Errors fall as h⁴ (1 + O(h)): by 16, and by 2⁴ ± ½ where the next order is a tenth of this.
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.5)


@every_nonlinear_structure
def test_a_test_starts_at_its_initial_displacement(structure, make_record):
    rng = np.random.default_rng(0)
    start = TYPICAL[structure.name][1]
    record = make_record(np.full(SAMPLES, start), levels(rng, SAMPLES))
    for direction in (1, -1):
        batch = Batch.of([record], LIFTING, dead_zone=0.0, sign=direction)
        model = PhysicalModel(structure, values_of(structure), jnp.asarray(0.0))
        travel = model.travel(batch)
        assert float(travel[0, 0]) == 0.0
        computed = np.asarray(batch.to_displacement(travel))[0, :SAMPLES]
        expected = displacement(structure, record.command(LIFTING))
        np.testing.assert_allclose(computed, expected, rtol=0, atol=4 * EPS * np.abs(expected).max())


@every_nonlinear_structure
def test_the_command_is_heard_whole_whatever_the_dead_zone(structure, make_record):
    record = make_record(np.full(SAMPLES, 5.0), levels(np.random.default_rng(0), SAMPLES, low=0.2))
    model = PhysicalModel(structure, values_of(structure), jnp.asarray(0.0))
    runs = [
        model.travel(Batch.of([record], LIFTING, dead_zone=zone, sign=1, initial=[5.0]))
        for zone in (0.0, 0.3)
    ]
    np.testing.assert_array_equal(*runs)


@every_nonlinear_structure
@pytest.mark.parametrize(
    ("option", "named"),
    [
        ({"dead_time": True}, "dead time"),
        ({"valve_curve": True, "spool_dynamics": True}, "valve curve and no spool dynamics"),
        ({"stroke_gain_quadratic": True}, "gain along the stroke"),
        ({"covariates": (CovariateEffects("pressure"),)}, "measured covariates"),
    ],
)
def test_a_nonlinear_structure_takes_no_options(structure, option, named):
    with pytest.raises(InputError, match=f"'{structure.name}' has no {named}; choose another structure"):
        ModelSpec(structure, **option)
    assert ModelSpec(structure).parameters == structure.parameters


@every_nonlinear_structure
def test_it_has_no_linear_model(structure):
    model = PhysicalModel(structure, values_of(structure), jnp.asarray(0.0))
    for step_s in (None, STEP_S):
        with pytest.raises(InputError, match=f"'{structure.name}' is not linear; expected a linear"):
            linearise(model, step_s)
    with pytest.raises(InputError, match="is not linear"):
        model.discretised(STEP_S)


@every_nonlinear_structure
def test_its_values_are_told_by_name(structure):
    named, _ = TYPICAL[structure.name]
    assert PhysicalModel(structure, values_of(structure), jnp.asarray(0.0)).named_values() == named


# --- inertia with friction ---------------------------------------------------------------------------------

INERTIA = structure_named("inertia-with-friction")
VISCOUS = {
    "offset": 0.0,
    "asymmetry": 0.0,
    "static_friction": 0.0,
    "offset_per_travel": 0.0,
    "initial_speed": 0.0,
}


def test_with_viscous_friction_an_inertia_is_a_lagged_integrator():
    gain, viscous, coulomb = AXIS["gain"], AXIS["viscous_friction"], 1e-12
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    computed = displacement(INERTIA, command, initial=3.0, coulomb_friction=coulomb, **VISCOUS) - 3.0
    expected = held([gain], [1.0, viscous, 0.0], command)
    # A step of the classical method gives exp(−B h) but for (B h)⁵/120 of the speed, which then adds up to
    # displacement over the rest of the test; Coulomb friction alone moves it by K c t²/2 at most.
    duration, fastest = SAMPLES * STEP_S, gain / viscous
    tolerance = SAMPLES * (viscous * STEP_S) ** 5 / 120 * fastest * duration
    tolerance += gain * coulomb * duration**2 / 2 + SAMPLES * EPS * expected.max()
    assert tolerance < 1e-6 * expected.max()
    np.testing.assert_allclose(computed, expected, rtol=0, atol=tolerance)


def test_an_offset_along_the_way_is_a_spring():
    """With o + d x: ẍ + B ẋ + K d x = −K o, in closed form up to a reversal, for a command of zero."""
    gain, viscous, duration = AXIS["gain"], AXIS["viscous_friction"], SAMPLES * STEP_S
    still = {**VISCOUS, "offset": -0.5, "offset_per_travel": 0.01, "coulomb_friction": 1e-12}
    computed = displacement(INERTIA, np.zeros(SAMPLES), initial=0.0, **still)
    t, far = STEP_S * np.arange(SAMPLES), 0.5 / 0.01
    root = np.sqrt(viscous**2 - 4 * gain * 0.01)
    slow, fast = (viscous - root) / 2, (viscous + root) / 2  # overdamped: it never reverses
    expected = far * (1 - (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / root)
    tolerance = SAMPLES * (fast * STEP_S) ** 5 / 120 * gain / viscous * duration
    np.testing.assert_allclose(computed, expected, rtol=0, atol=tolerance + 1e-12 * gain * duration**2)


def test_an_inertia_at_rest_keeps_its_offset():
    held_back = displacement(
        INERTIA, np.zeros(SAMPLES), initial=5.0, **{**VISCOUS, "offset_per_travel": 0.5, "offset": 0.0}
    )
    np.testing.assert_array_equal(held_back, 5.0)


@pytest.mark.parametrize("share", [-0.9, 0.5, 0.9])
def test_a_force_below_coulomb_friction_moves_it_practically_nothing(share):
    gain, viscous, coulomb = (AXIS[name] for name in ("gain", "viscous_friction", "coulomb_friction"))
    computed = displacement(INERTIA, np.full(SAMPLES, share * coulomb), initial=5.0, **VISCOUS) - 5.0
    # From rest its speed grows to where K (u − c tanh(v/v₀)) = B v, below v₀ artanh(u/c).
    creeping = SIGN_SMOOTHING * gain * coulomb / viscous * np.arctanh(abs(share))
    bound = creeping * STEP_S * np.arange(SAMPLES)
    assert np.all(np.sign(share) * computed >= 0.0)
    assert np.all(np.abs(computed) <= bound + EPS * 5.0)
    # Without friction it would be farther away by two orders.
    free = share * coulomb * gain * (STEP_S * (SAMPLES - 1)) ** 2 / 2
    assert abs(computed[-1]) < 0.02 * abs(free)


def test_coulomb_friction_stops_a_mass_as_in_closed_form():
    """From v̇ = −B v − K c: it stands after ln(1 + v B/(K c))/B, having gone (v − K c t)/B."""
    gain, viscous, coulomb = (AXIS[name] for name in ("gain", "viscous_friction", "coulomb_friction"))
    start, slowed = 40.0, gain * coulomb
    computed = displacement(INERTIA, np.zeros(400), initial=0.0, **{**VISCOUS, "initial_speed": start})
    stops = np.log(1 + start * viscous / slowed) / viscous
    assert stops < 2.5
    gone = (start - slowed * stops) / viscous
    # In the smooth sign the last v₀ of speed takes longer: below 3 v₀ the force is short of K c, and what
    # is left of speed v₀ runs out within v₀²/(K c) · (1 + 3²/2).
    smooth = SIGN_SMOOTHING * slowed / viscous
    assert 0.0 <= computed[-1] - gone <= 5.5 * smooth**2 / slowed + smooth * STEP_S
    assert abs(computed[-1] - computed[300]) < smooth * STEP_S


# --- cascaded tanks ----------------------------------------------------------------------------------------

CASCADE = structure_named("cascaded-tanks")
BRIM = TANKS["brim"]


def standing(pumped, rate):
    """Return the levels ξ₁ and ξ₂ at which as much leaves each tank as comes in."""
    upper = (TANKS["inflow"] * pumped / TANKS["upper_outflow"]) ** 2
    entering = TANKS["transfer"] * np.sqrt(upper)
    if rate == 0:
        return upper, (entering / TANKS["lower_outflow"]) ** 2
    root = np.sqrt(TANKS["lower_outflow"] ** 2 + 4 * rate * entering) - TANKS["lower_outflow"]
    return upper, (root / (2 * rate)) ** 2


@pytest.mark.parametrize("rate", [0.0, 0.004, -0.004])
@pytest.mark.parametrize("pumped", [1.2, 2.1])
def test_levels_stay_and_end_where_inflow_and_outflow_balance(pumped, rate):
    upper, lower = standing(pumped, rate)
    assert max(upper, lower) < 0.9
    command = np.full(700, pumped)
    stays = displacement(
        CASCADE, command, initial=BRIM * lower, step_s=4.0, outflow_correction=rate, initial_upper_level=upper
    )
    np.testing.assert_allclose(stays, BRIM * lower, rtol=700 * EPS)
    comes = displacement(
        CASCADE, command, initial=3.0, step_s=4.0, outflow_correction=rate, initial_upper_level=0.9
    )
    # Linearised, a tank forgets at a₂/(2√ξ₂) + l per second: 2800 s are more than thirty time constants.
    rate = min(
        TANKS["lower_outflow"] / (2 * np.sqrt(lower)) + rate, TANKS["upper_outflow"] / (2 * np.sqrt(upper))
    )
    assert np.exp(-rate * 2400) < 1e-9
    assert comes[-1] == pytest.approx(BRIM * lower, rel=1e-8)
    assert abs(comes[100] - BRIM * lower) > 1e-8 * BRIM


def test_the_root_of_an_emptying_level_falls_linearly():
    """Torricelli: with nothing coming in, √ξ₂ = √ξ₂(0) − a₂ t/2."""
    outflow, step_s, start = TANKS["lower_outflow"], 1.0, 0.8
    lonely = {"transfer": 1e-12, "outflow_correction": 0.0, "initial_upper_level": 0.5}
    t = step_s * np.arange(40)
    root = np.sqrt(start) - outflow * t / 2
    assert root[-1] > 0.1
    computed = displacement(CASCADE, np.zeros(t.size), initial=BRIM * start, step_s=step_s, **lonely)
    # The classical method takes √ξ for its Taylor series over a step of ½ s, in which √ξ falls by a tenth
    # of itself at most: what is left out is (1/10)⁵ of the fall of that step. In 1e-12 s⁻¹ · 40 s comes in.
    share = outflow * step_s / 4 / root[-1]
    assert share < 0.11
    np.testing.assert_allclose(np.sqrt(computed / BRIM), root, rtol=0, atol=share**5 * outflow * t[-1] / 2)


def test_an_empty_tank_stays_empty():
    computed = displacement(
        CASCADE,
        np.zeros(2000),
        initial=0.0,
        step_s=4.0,
        outflow_correction=0.0,
        initial_upper_level=0.0,
        transfer=1e-12,
    )
    # Below the level that counts as empty the outflow is that of this level.
    assert np.all(np.abs(computed) <= BRIM * TANKS["lower_outflow"] * np.sqrt(EMPTY) * 4.0 * np.arange(2000))
    assert np.all(np.diff(computed) <= 0.0)


def test_the_lower_tank_stays_within_its_smooth_brim():
    step_s, pumped = 0.2, 5.0
    command = np.full(3000, pumped)
    computed = displacement(CASCADE, command, initial=5.0, step_s=step_s, outflow_correction=0.0) / BRIM
    # Above the brim what comes in, N at most, enters by e^(−(ξ − 1)/δ) at most: e^((ξ − 1)/δ) ≤ 1 + N t/δ. A
    # step of integration may begin just below and end N h above.
    surplus = TANKS["transfer"] * 1.05 + TANKS["spill"] * TANKS["inflow"] * pumped
    edge = LOWER_BRIM * np.log1p(surplus * step_s * command.size / LOWER_BRIM)
    assert edge < 0.025
    assert 1.0 < computed.max() <= 1 + edge + surplus * step_s / CASCADE.substeps


def test_a_full_upper_tank_spills_into_the_lower_one():
    """Both full inflow and overflow end in the lower tank: b + s (k u − a₁) = a₂ √ξ₂ with ξ₁ = 1."""
    pumped = 3.1
    over = TANKS["inflow"] * pumped - TANKS["upper_outflow"]
    assert 0 < over < 0.1 * TANKS["upper_outflow"]
    values = {"outflow_correction": 0.0, "lower_outflow": 0.05, "initial_upper_level": 1.0}
    computed = displacement(CASCADE, np.full(1000, pumped), initial=4.0, step_s=4.0, **values)[-1] / BRIM
    # The upper level lies within its smooth edge: above where half of it spills, by ln of 1 + t/δ at most.
    upper = np.array([1.0, 1 + 0.005 * np.log1p(over * 4000 / 0.005)])
    spilt = np.maximum(TANKS["inflow"] * pumped - TANKS["upper_outflow"] * np.sqrt(upper), 0.0)
    least, most = ((TANKS["transfer"] * np.sqrt(upper) + TANKS["spill"] * spilt) / 0.05) ** 2
    assert min(least, most) * (1 - 1e-3) <= computed <= max(least, most) * (1 + 1e-3)
