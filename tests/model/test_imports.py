"""A deployed model is loaded without what identified it."""

import json
import subprocess
import sys

import pytest

from handmade import hitch
from hitchid.model import save

IDENTIFICATION = (
    "hitchid.baselines.registry",
    "hitchid.estimation",
    "hitchid.identification",
    "hitchid.uncertainty",
    "hitchid._support.checkpoints",
    "matplotlib",
    "optax",
    "scipy.optimize",
)
SCRIPT = """
import json, sys
import hitchid.model
for folder in sys.argv[1:]:
    hitchid.model.load(folder)
print(json.dumps(sorted(sys.modules)))
"""


@pytest.mark.parametrize("loaded", [False, True], ids=["imported", "loaded"])
def test_the_model_needs_no_search_no_checkpoint_and_no_optimiser(tmp_path, loaded):
    folders = []
    if loaded:
        save(hitch(compensated=True, free_run=True), tmp_path / "model")
        folders = [str(tmp_path / "model")]
    command = [sys.executable, "-c", SCRIPT, *folders]
    run = subprocess.run(command, capture_output=True, check=True, text=True)  # noqa: S603
    modules = json.loads(run.stdout)
    assert "hitchid.model.hitch" in modules
    assert [name for name in IDENTIFICATION if name in modules] == []
