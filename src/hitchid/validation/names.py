"""Names of models and runs, for tables, notices and figures."""

from collections.abc import Iterable
from string import ascii_uppercase

from hitchid.baselines.registry import BASELINES, all_baselines

CYCLES = "cycles"
GREYBOX, BENCHMARK, PERSISTENCE = "greybox", "benchmark", "persistence"
ONE_STEP, FREE_RUN = "one_step", "free_run"
NAMES = {
    PERSISTENCE: "persistence",
    **{baseline.name: baseline.title for baseline in BASELINES},
    "transfer_function": "paper's transfer function",
    "paper": "paper's grey box",
    BENCHMARK: "physics model",
    GREYBOX: "grey box",
}
RUNS = {ONE_STEP: "one step", FREE_RUN: "free run"}
LABELS = NAMES | {
    "benchmark": "physics model, free run",
    "one_step": "grey box, one step",
    "free_run": "grey box, free run",
    "mechanistic": "mechanistic, free run",
    "paper_one_step": "paper's grey box, one step",
    **{letter: f"model {letter}" for letter in ascii_uppercase[:8]},  # as many as a figure shows
}


def model_name(key: str) -> str:
    """Return the name of a model; the key where the package of a baseline is not installed."""
    if key in NAMES:  # the packages installed are asked only for names that are not our own: that takes long
        return NAMES[key]
    extensions = all_baselines()
    return extensions[key].title if key in extensions else key


def in_table_order(keys: Iterable[str]) -> list[str]:
    """Return models in the order of tables: baselines, those of other packages, benchmark, grey box."""
    present = list(keys)
    others = [key for key in present if key not in NAMES]
    ordered = [*(key for key in NAMES if key not in (BENCHMARK, GREYBOX)), *others, BENCHMARK, GREYBOX]
    return [key for key in ordered if key in present]


def label(key: str) -> str:
    """Return the name of a model and its run in a legend; the key itself for other models."""
    return LABELS.get(key, key)
