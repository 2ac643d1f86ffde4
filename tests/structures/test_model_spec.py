"""A form goes without any of its optional parameters, and becomes the smallest that has the others."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.structures import CovariateEffects, ModelSpec, Scales, structure_named

LARGEST = ModelSpec(
    structure_named("integrator-second-order"),
    dead_time=True,
    valve_curve=True,
    spool_dynamics=True,
    stroke_gain_quadratic=True,
    covariates=(CovariateEffects("oil", True, True), CovariateEffects("pressure", True, True)),
)
NAMES = [parameter.name for parameter in LARGEST.parameters]
OWN = {parameter.name for parameter in LARGEST.structure.parameters}
SCALES = Scales(*(jnp.asarray(scale) for scale in (1.0, 90.0, 40.0)))


@given(kept=st.sets(st.sampled_from([name for name in NAMES if name not in OWN])))
def test_a_form_limited_to_some_parameters_has_these_and_its_structures(kept):
    smaller = LARGEST.limited_to(kept)
    assert {parameter.name for parameter in smaller.parameters} == OWN | kept
    assert smaller.limited_to(kept) == smaller
    # No option is on of which nothing is left.
    for option in ("valve_curve", "spool_dynamics", "stroke_gain_linear", "stroke_gain_quadratic"):
        if getattr(smaller, option):
            assert len(replace(smaller, without=()).parameters) > len(
                replace(smaller, without=(), **{option: False}).parameters
            )
    assert all(any(name in p for p in kept) for name in smaller.covariate_names)


def test_a_parameter_that_a_form_goes_without_has_no_effect():
    plain = ModelSpec(LARGEST.structure, valve_curve=True)
    powered = replace(plain, without=("opening", "saturation"))
    assert [parameter.name for parameter in powered.parameters[-1:]] == ["exponent"]
    model = powered.physical_model(jnp.array([20.0, 15.0, 0.8, 2.0]), SCALES)
    command = jnp.array([[0.1, 0.5, 1.0]])
    np.testing.assert_allclose(model.nonlinearity.flow(command), command**2, rtol=1e-12)


def test_what_is_no_parameter_of_an_option_is_refused():
    for form in (ModelSpec(LARGEST.structure), replace(LARGEST, covariates=())):
        with pytest.raises(InputError, match=r"without: there is no parameter 'gain' of an option; expected"):
            replace(form, without=("gain",))
