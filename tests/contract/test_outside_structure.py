"""A structure of another package: chosen automatically, saved, loaded, validated, named in settings."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hitchid
from hitchid.errors import InputError
from hitchid.identification import ModelSpec, MultiStart, read_settings
from hitchid.identification.candidates import largest_spec, nested_specs
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, Record
from hitchid.structures import CovariateEffects, PhysicalModel, registered_structures, structure_named
from truth import STEP_S, held, levels

NAME = "leaking-cylinder"
GAIN, LEAK_TIME, LAG = 20.0, 0.8, 0.06
FRACTION = [GAIN * LEAK_TIME], [LEAK_TIME * LAG, LEAK_TIME + LAG, 1.0]
NOISE = 0.02
WIDEST = largest_spec(ModelSpec(structure_named("integrator")), opening_known=True)


@pytest.fixture(scope="module")
def installed(install):
    """Install the example."""
    with pytest.MonkeyPatch.context() as patch:
        install(patch, "structure_from_outside")
        yield


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    """Return tests of a plant simulated by scipy, each at a level of its own and at rest at its end."""
    rng, samples, records = np.random.default_rng(0), 250, []
    for number, top in enumerate(np.linspace(0.3, 1.0, 10)):
        command = top * levels(rng, samples, low=0.5)
        command[2 * samples // 3 :] = 0.0
        displacement = 50.0 + held(*FRACTION, command) + NOISE * rng.standard_normal(samples)
        signals = {"displacement": displacement, "lifting_command": command}
        units = {"displacement": "mm", "lifting_command": "A"}
        records.append(Record(name=f"lifting-{number:02d}", step_s=STEP_S, signals=signals, units=units))
    return Campaign.of(records)


@pytest.fixture(scope="module")
def identified(installed, campaign):
    return hitchid.identify(
        campaign, training=None, rivals=None, search=MultiStart(evaluations=60), dead_zones={LIFTING: 0.0}
    )


def test_without_the_package_its_name_is_refused():
    with pytest.raises(InputError, match=f"no structure '{NAME}'; expected one of integrator-second-order"):
        structure_named(NAME)


def test_it_is_a_structure_by_name_and_in_settings(installed, tmp_path):
    assert list(registered_structures())[-1] == NAME
    path = tmp_path / "settings.toml"
    path.write_text(f'[lifting]\nstructure = "{NAME}"\nspool = true\n')
    spec = read_settings(path).get("structure", {})[LIFTING]
    assert spec == ModelSpec(structure_named(NAME), spool_dynamics=True)


def test_it_simulates_as_its_transfer_function(installed):
    command = levels(np.random.default_rng(1), 200)
    model = PhysicalModel(structure_named(NAME), jnp.array([LEAK_TIME, LAG, GAIN]), jnp.asarray(0.0))
    expected = held(*FRACTION, command)
    simulated = np.asarray(model.response(jnp.asarray(command)[None], STEP_S))[0]
    np.testing.assert_allclose(simulated, expected, atol=1e-10 * np.abs(expected).max())
    assert float(model.gain) == GAIN
    np.testing.assert_allclose(model.with_gain(1.5).values, [LEAK_TIME, LAG, 1.5 * GAIN])


def test_the_automatic_choice_finds_it(identified):
    trace = identified.channels[LIFTING]
    (chosen,) = (candidate for candidate in trace.candidates if candidate.chosen)
    assert chosen.spec.structure.name == NAME
    estimates = {estimate.name: estimate for estimate in trace.phase1.parameter_estimates}
    truth = {"gain": GAIN, "leak_time": LEAK_TIME, "lag": LAG}
    for name, value in truth.items():
        # Four standard errors: 1 in 16000 for each.
        assert abs(estimates[name].value - value) <= 4 * estimates[name].error
        assert estimates[name].determined
    # Noise alone is left.
    assert trace.phase1.rmse == pytest.approx(NOISE, rel=0.1)


def test_it_is_saved_loaded_and_validated_under_its_name(identified, campaign, tmp_path):
    identified.save(tmp_path / "model")
    model = hitchid.load(tmp_path / "model")
    assert model.channels[LIFTING].benchmark.structure.name == NAME
    record = campaign.records[-1]
    np.testing.assert_array_equal(
        model.simulate(record).displacement, identified.model.simulate(record).displacement
    )
    rmse = np.sqrt(np.mean((model.simulate(record).displacement - record.displacement) ** 2))
    assert rmse == pytest.approx(NOISE, rel=0.2)
    hitchid.validate(model, campaign)
    trace = json.loads((tmp_path / "model" / "trace.json").read_text())
    assert NAME in [candidate["name"] for candidate in trace[LIFTING]["candidates"]]
    stored = json.loads((tmp_path / "model" / "model.json").read_text())
    assert stored["channels"][LIFTING]["structure"] == NAME


def test_a_form_keeps_the_options_that_the_structure_takes(installed):
    structure = structure_named(NAME)
    for _, spec in nested_specs(replace(WIDEST, covariates=(CovariateEffects("pressure", dynamics=True),))):
        assert spec.with_structure(structure).options == spec.options
        assert spec.with_structure(structure).bounds == dict(spec.bounds)
    assert ModelSpec(structure_named("cascaded-tanks")) == WIDEST.with_structure(
        structure_named("cascaded-tanks")
    )
