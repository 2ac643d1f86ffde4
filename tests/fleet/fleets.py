"""Stores of logs of made-up machines, and settings that identify one in a second."""

from pathlib import Path

from benches import write_bench
from hitchid.identification import MultiStart

MACHINES = 2
QUICK = {
    "structure": {"lifting": "integrator", "lowering": "integrator"},
    "search": MultiStart(evaluations=60),
    "training": None,
    "rivals": None,
}
QUICK_TOML = """
[search]
method = "multi-start"
evaluations = 60
compare = false
[training]
compensator = false
[lifting]
structure = "integrator"
[lowering]
structure = "integrator"
"""


def write_fleet(folder: Path, machines: int) -> Path:
    """Write a folder of logs for each of several machines, and return the folder that holds them."""
    folder.mkdir(parents=True)
    for number in range(machines):
        write_bench(folder / f"tractor-{number}", tests=3, samples=300, seed=number)
    return folder


def model_digests(results: Path) -> dict[str, bytes]:
    """Return path to content of all files of all models in a store of results."""
    models = results / "models"
    files = (path for path in models.rglob("*") if path.is_file())
    return {path.relative_to(models).as_posix(): path.read_bytes() for path in files}
