"""Compressibility and orifices against derivatives and their own inverses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench.valves import TANK_PRESSURE_PA, orifice_flow


@pytest.mark.parametrize("pressure", [5e3, 1e5, 1e6, 8e6, 3e7])
def test_pressure_is_the_inverse_of_amount(rig, pressure):
    oil, volume, yielding = rig.oil, jnp.asarray(1e-3), jnp.asarray(2e-11)
    amount = oil.amount(jnp.asarray(pressure), volume, yielding)
    np.testing.assert_allclose(oil.pressure(amount, volume, yielding), pressure, rtol=1e-8)
    slope = jax.grad(oil.amount)(jnp.asarray(pressure), volume, yielding)
    np.testing.assert_allclose(oil.capacity(jnp.asarray(pressure), amount, yielding), slope, rtol=1e-9)


def test_air_softens_the_oil_at_low_pressure(rig):
    oil, volume = rig.oil, jnp.asarray(1e-3)

    def modulus(pressure):
        p = jnp.asarray(pressure)
        return float(volume / oil.capacity(p, oil.amount(p, volume, jnp.asarray(0.0)), jnp.asarray(0.0)))

    assert modulus(2e5) < 0.05 * float(oil.bulk_modulus)
    assert modulus(2e7) == pytest.approx(float(oil.bulk_modulus), rel=0.05)


@pytest.mark.parametrize("stored", [2e6, 1.2e7])
def test_the_accumulator_gives_back_what_it_took(rig, stored):
    import equinox as eqx

    supply = eqx.tree_at(lambda s: s.accumulator_volume, rig.supply, jnp.asarray(5e-4))
    pressure = jnp.asarray(stored)
    amount = supply.amount(rig.oil, pressure)
    np.testing.assert_allclose(supply.pressure(rig.oil, amount), stored, rtol=1e-9)
    slope = jax.grad(supply.amount, argnums=1)(rig.oil, pressure)
    np.testing.assert_allclose(supply.capacity(rig.oil, pressure, amount), slope, rtol=1e-9)


def test_orifice_flow_is_the_root_of_the_drop():
    g = jnp.asarray(1e-7)
    for drop in (-3e6, -1e4, 0.0, 5e3, 1e5, 8e6):
        flow, slope = orifice_flow(g, jnp.asarray(drop))
        np.testing.assert_allclose(slope, jax.grad(lambda d: orifice_flow(g, d)[0])(drop), rtol=1e-9)
        if abs(drop) > 1e6:
            np.testing.assert_allclose(flow, np.sign(drop) * 1e-7 * np.sqrt(abs(drop)), rtol=1e-4)


def test_the_pump_on_relief_is_in_balance(any_rig):
    pressure = any_rig.supply.idle_pressure()
    delivered, _ = any_rig.supply.pump_delivery(pressure, jnp.asarray(1.0))
    np.testing.assert_allclose(any_rig.supply.relief_flow(pressure)[0], delivered, rtol=1e-12)
    assert pressure > TANK_PRESSURE_PA + any_rig.supply.relief_pressure
