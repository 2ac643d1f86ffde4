"""Names of models and runs, as they stand in tables, notices and figures."""

from collections.abc import Iterable

CYCLES = "cycles"
GREYBOX, BENCHMARK, PERSISTENCE = "greybox", "benchmark", "persistence"
ONE_STEP, FREE_RUN = "one_step", "free_run"
NAMES = {
    PERSISTENCE: "persistence",
    "arx": "ARX",
    "narx": "NARX",
    "lstm": "black-box LSTM",
    "transfer_function": "paper's transfer function",
    "paper": "paper's grey box",
    BENCHMARK: "benchmark",
    GREYBOX: "grey box",
}
RUNS = {ONE_STEP: "one step", FREE_RUN: "free run"}


def model_name(key: str) -> str:
    """Return the name of a model; one of another package is called by its key."""
    return NAMES.get(key, key)


def in_table_order(keys: Iterable[str]) -> list[str]:
    """Return models in the order of tables: baselines, those of other packages, benchmark, grey box."""
    present = list(keys)
    others = [key for key in present if key not in NAMES]
    ordered = [*(key for key in NAMES if key not in (BENCHMARK, GREYBOX)), *others, BENCHMARK, GREYBOX]
    return [key for key in ordered if key in present]
