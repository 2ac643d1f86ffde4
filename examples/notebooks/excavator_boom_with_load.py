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
# ---

# %% [markdown]
# # Excavator boom with load
#
# The boom of an excavator raises a light and a heavy bucket. At equal command the heavy one is slower, so a model without
# the load cannot fit both. The head pressure before motion represents the load.
#
# The logs are in the folder `excavator-boom` of `HITCHID_DATA`. Their `campaign.toml` names the columns, the covariate
# `head_pressure`, and the held-out tests.

# %%
import os
from pathlib import Path

import hitchid

campaign = hitchid.read(Path(os.environ["HITCHID_DATA"]) / "excavator-boom")
for record in campaign.of_kind("lifting"):
    pressure = record.signals["head_pressure"][0]
    travel = record.displacement[-1] - record.displacement[0]
    print(f"{record.name}: head pressure {pressure:.0f} before motion, travel {travel:.1f} {record.unit}")

# %% [markdown]
# ## With and without the load
#
# The same structure twice: a transfer function, without and with the load. Lowering has no load: before it the boom is at
# its upper stop, and the pressure contains no information. A short search without networks takes seconds.

# %%
from hitchid.estimation import Whale
from hitchid.estimation.global_search.whale import WhaleConfig
from hitchid.identification import ModelSpec
from hitchid.structures import structure_named

structure = structure_named("integrator-first-order")
lowering = ModelSpec(structure)
quick = {"search": Whale(WhaleConfig(evaluations=300)), "training": None, "comparison": None}
loads = {"without load": None, "with load": "head_pressure"}
models = {}
for name, covariate in loads.items():
    raising = ModelSpec(structure, covariate=covariate)
    specs = {"lifting": raising, "lowering": lowering}
    models[name] = hitchid.identify(campaign, structure=specs, **quick).model

# %% [markdown]
# ## Free run on the held-out tests

# %%
for name, model in models.items():
    free_run = hitchid.validate(model, campaign).channels["lifting"].accuracy.free_run()
    print(f"{name}: RMSE {free_run.rmse:.2f} deg, R² {free_run.r2:.3f}")
