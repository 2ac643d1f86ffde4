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
# `head_pressure`, and the held-out tests. Only raising is modelled here.

# %%
import os
from pathlib import Path

import hitchid

boom = hitchid.read(Path(os.environ["HITCHID_DATA"]) / "excavator-boom")
campaign = hitchid.Campaign.of(boom.of_kind("lifting"), test_patterns=["*-050-*", "*-090-*"])
for record in campaign.records:
    pressure = record.signals["head_pressure"][0]
    travel = record.displacement[-1] - record.displacement[0]
    print(f"{record.name}: head pressure {pressure:.0f} before motion, travel {travel:.1f} {record.unit}")

# %% [markdown]
# ## Identify
#
# A transfer function with a valve curve, and the load, without networks.

# %%
from hitchid.identification import ModelSpec
from hitchid.structures import CovariateEffects, structure_named

spec = ModelSpec(
    structure_named("integrator-first-order"),
    valve_curve=True,
    covariates=(CovariateEffects("head_pressure"),),
)
found = hitchid.identify(campaign, structure={"lifting": spec}, training=None, rivals=None)

# %% [markdown]
# ## Free run on the held-out tests
#
# With the load as measured, and with the mean pressure of all tests in its place.

# %%
from dataclasses import replace

import numpy as np

mean = np.mean([record.signals["head_pressure"][0] for record in campaign.records])
for record in campaign.held_out("lifting"):
    unknown = replace(record, signals={**record.signals, "head_pressure": np.full(len(record), mean)})
    errors = [np.asarray(found.model.simulate(test)) - record.displacement for test in (record, unknown)]
    measured, average = (np.sqrt(np.mean(error**2)) for error in errors)
    print(f"{record.name}: RMSE {measured:.1f} deg with the load, {average:.1f} deg with the mean load")
