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
# # First model from CSV
#
# From a folder of CSV logs to a validated model. The logs come from the virtual test bench; with your own logs, start at
# "Read the logs" and assign your columns in a `campaign.toml`.

# %%
from hitchid.bench.virtual_campaign import write_campaign

write_campaign("logs", tests={"ramp": 2, "prbs": 6}, force=True)

# %% [markdown]
# ## Read the logs
#
# One CSV file is one test. The kind of each test is detected from its commands; the last 20 % of each direction's tests are
# held out for validation.

# %%
import hitchid
from hitchid.logs.audit import audit

campaign = hitchid.read("logs")
for record in campaign.records:
    print(record.name, record.kind, f"{len(record)} samples every {record.step_s} s")

# %% [markdown]
# The audit finds problems in logs before a fit.

# %%
for finding in audit(campaign):
    print(f"{finding.severity.value}: {finding.what} → {finding.advice}")

# %% [markdown]
# ## Identify
#
# Without arguments `identify` selects the structures itself and trains networks, which takes minutes. Here the structures
# are named, and there are no networks and no comparison of searches: transfer functions with dead zones, in seconds.

# %%
structures = {"lifting": "integrator-second-order", "lowering": "first-order-lag"}
model = hitchid.identify(campaign, structure=structures, training=None, rivals=None).model

# %% [markdown]
# Each parameter has a 95 % interval and a verdict. Tests of ten seconds do not determine the time constant of lowering:
# only the speed per ampere, K/τ.

# %%
for direction, uncertainty in model.uncertainty.items():
    for estimate in uncertainty.benchmark.parameters:
        print(direction, estimate.symbol, f"{estimate.value:.4g} {estimate.unit}", estimate.verdict)

# %% [markdown]
# ## Validate
#
# Free run on the tests that were not used for identification: from the commands and the initial displacement alone.

# %%
validation = hitchid.validate(model, campaign)
for direction, result in validation.channels.items():
    free_run = result.accuracy.free_run()
    print(f"{direction}: RMSE {free_run.rmse:.3f} {validation.unit}, fit {free_run.fit:.1f} %")

# %% [markdown]
# The report is one HTML file.

# %%
validation.to_html("report.html", force=True)
hitchid.save(model, "model", force=True)
