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
# # From DataFrame to controller
#
# From pandas tables to a linear model for python-control. The tables here are logs of the virtual test bench; with your own
# tables, start at "Model". It needs `pip install "hitchid[control]"` and pandas.

# %%
from hitchid.bench.virtual_campaign import write_campaign

write_campaign("logs", tests={"prbs": 6}, directions=["lifting"], force=True)

# %% [markdown]
# ## Model
#
# One table is one test. `signals` assigns columns to signals; a unit comes from the name of the column, or is given as in
# `{"column": "i_up", "unit": "A"}`. The time and the displacement have their default columns, `time_s` and
# `displacement_mm`. The structure is named and no network is trained, so that this takes seconds.

# %%
import control
import pandas

import hitchid

signals = {"lifting_command": "current_up_A", "lowering_command": "current_down_A"}
frames = [pandas.read_csv(f"logs/lifting-{number:02}.csv") for number in range(1, 7)]
campaign = hitchid.Campaign.from_dataframes(frames, signals=signals)
structure = {"lifting": "integrator-second-order"}
model = hitchid.identify(campaign, structure=structure, training=None, rivals=None).model

# %% [markdown]
# ## Parameters
#
# Each with a 95 % interval and a verdict.

# %%
print(model.parameters.to_dataframe())

# %% [markdown]
# ## Step response with its 95 % band

# %%
axes = model.plot_step_response()

# %% [markdown]
# ## Simulation from commands alone
#
# Two seconds of 0.6 A from 20 mm, one value every 10 ms.

# %%
print(model.simulate([0.6] * 200, step_s=0.01, initial=20.0).to_dataframe().tail())

# %% [markdown]
# ## Controller
#
# Gain and phase margin of a proportional controller of 0.05 A/mm with the linear model: from the command above the dead zone
# to the displacement.

# %%
print(control.margin(0.05 * model.to_control("lifting"))[:2])
