# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3

# %% [markdown]
# # Own position controller, and what 30 ms more delay does
#
# A controller is any object with two functions: `initial_state(displacement_mm)`, and `step(state, target_mm, measured_mm)`
# that returns the next state and both currents. An `equinox.Module` is traced by JAX and runs many loops at once.
#
# The model is identified from few tests and with fixed structures, so that this takes a minute.

# %%
import hitchid
from hitchid.bench.virtual_campaign import write_campaign

write_campaign("logs", tests={"prbs": 6}, force=True)
structures = {"lifting": "integrator-second-order", "lowering": "integrator-first-order"}
model = hitchid.identify(hitchid.read("logs"), structure=structures, training=None, rivals=None).model

# %% [markdown]
# ## A tuned controller, and the delay that it bears
#
# The delay margin is met by 95 % of the models with drawn parameters, at nine operating points.

# %%
from hitchid.control import tune

tuning = tune(model, draws=40)
for direction, margins in tuning.margins.items():
    print(f"{direction}: {1e3 * margins.worst.delay_s:.0f} ms more delay until the loop is unstable")

# %% [markdown]
# ## The same controller behind a slow bus
#
# This controller gets each measurement three samples late, that is 30 ms. The predictor does not know of it.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp


class Delayed(eqx.Module):
    controller: eqx.Module
    samples: int = eqx.field(static=True)

    def initial_state(self, displacement_mm):
        waiting = jnp.full(self.samples + 1, displacement_mm)
        return self.controller.initial_state(displacement_mm), waiting

    def step(self, state, target_mm, measured_mm):
        inner, waiting = state
        waiting = jnp.append(waiting[1:], measured_mm)
        inner, currents = self.controller.step(inner, target_mm, waiting[0])
        return (inner, waiting), currents


# %% [markdown]
# ## A proportional controller of one's own
#
# It knows the dead zones, and closes both valves near the target and without a measurement.


# %%
class Proportional(eqx.Module):
    gain_a_mm: float = 0.1
    dead_zone_a: float = 0.35

    def initial_state(self, displacement_mm):
        return jnp.zeros(())  # it needs no state

    def step(self, state, target_mm, measured_mm):
        error = target_mm - measured_mm
        current = jnp.minimum(self.dead_zone_a + self.gain_a_mm * jnp.abs(error), 1.0)
        current = jnp.where(jnp.abs(error) > 0.5, current, 0.0)  # NaN compares as false
        return state, jnp.stack([jnp.where(error > 0, current, 0.0), jnp.where(error < 0, current, 0.0)])


# %% [markdown]
# ## Steps of 20 mm on the virtual bench
#
# Four loops each, with implements from 90 to 110 % of the mass and noise of their own.

# %%
import numpy as np

from hitchid.bench import load_rig
from hitchid.control import run_closed_loops

target = np.concatenate([np.full(100, 115.0), np.full(400, 135.0)])
controllers = {
    "tuned": tuning.controller,
    "tuned, 30 ms late": Delayed(tuning.controller, 3),
    "proportional": Proportional(),
    "proportional, 30 ms late": Delayed(Proportional(), 3),
}
for name, controller in controllers.items():
    loops = run_closed_loops(
        controller,
        load_rig("nominal"),
        jax.random.key(0),
        target,
        start_mm=115.0,
        implement_factors=np.linspace(0.9, 1.1, 4),
    )
    beyond = np.max(loops.displacement - 135.0)
    error = np.mean(np.abs(loops.displacement - target))
    print(f"{name}: overshoot {beyond:.2f} mm, mean error {error:.2f} mm")
