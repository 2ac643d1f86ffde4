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
# # A controller for each load
#
# A model whose parameters vary with the measured pressure gives a controller for every load: valve curve, lags and predictor
# are taken there, the gains stay.
#
# The tests are of two implements, with the cylinder pressure measured. The structures are fixed and no network is
# trained, so that this takes a minute or two.

# %%
import hitchid
from hitchid.bench.virtual_campaign import Conditions, write_campaign
from hitchid.identification import ModelSpec
from hitchid.structures import CovariateEffects, structure_named

write_campaign("logs", tests={"prbs": 6}, conditions=Conditions(implements_kg=(450.0, 1300.0)), force=True)
spec = ModelSpec(
    structure_named("integrator-first-order"),
    valve_curve=True,
    covariates=(CovariateEffects("pressure_bar"),),
)
structures = {"lifting": spec, "lowering": spec}
model = hitchid.identify(hitchid.read("logs"), structure=structures, training=None, rivals=None).model
for direction, channel in model.channels.items():
    print(direction, "varies with", *channel.benchmark.covariates)

# %% [markdown]
# ## Tuned for one load, scheduled to others
#
# The controllers at the lightest and the heaviest load of the tests. A covariate without a value has its mean in the
# tests. The margins hold for the load that was tuned for.

# %%
import numpy as np

from hitchid.control import tune

controller = tune(model, draws=40).controller
pressure = model.channels["lifting"].operating_range.load
scheduled = {}
for name, bar in (("light", np.min(pressure.lowest)), ("heavy", np.max(pressure.highest))):
    scheduled[name] = controller.at_load({"pressure_bar": float(bar)})
    print(f"{name}: {bar:.0f} bar")

# %% [markdown]
# ## Steps of 20 mm with 450 and 1300 kg on the virtual bench
#
# The controller at the mean load beside that of each load.

# %%
import jax

from hitchid.bench import load_rig
from hitchid.control import Surroundings, run_closed_loops

target = np.concatenate([np.full(100, 115.0), np.full(400, 135.0)])
for name, mass_kg in (("light", 450.0), ("heavy", 1300.0)):
    for title, each in (("mean load", controller), ("this load", scheduled[name])):
        loops = run_closed_loops(
            each,
            load_rig("nominal"),
            jax.random.key(0),
            target,
            start_mm=115.0,
            implement_factors=np.ones(4),
            surroundings=Surroundings(implement_kg=mass_kg),
        )
        error = np.mean(np.abs(loops.displacement - target))
        print(f"{name}, controller for the {title}: mean error {error:.2f} mm")
