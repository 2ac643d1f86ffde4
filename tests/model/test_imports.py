"""A deployed model is loaded without what identified it, and nothing is drawn before a plot is asked for."""

import json
import subprocess
import sys

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
hitchid.model.load(sys.argv[1])
loaded = sorted(sys.modules)
import hitchid.logs.campaign, hitchid.validation
print(json.dumps([loaded, sorted(sys.modules)]))
"""

EACH_FIRST = """
import sys, hitchid
for room in hitchid._PACKAGES:
    for name in [name for name in sys.modules if name.startswith("hitchid")]:
        del sys.modules[name]
    import hitchid
    getattr(hitchid, room)
"""


def test_each_room_can_be_the_first_that_is_imported():
    subprocess.run([sys.executable, "-c", EACH_FIRST], check=True)  # noqa: S603


def test_a_model_needs_no_search_and_no_result_needs_matplotlib(tmp_path):
    save(hitch(compensated=True, free_run=True), tmp_path / "model")
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "model")]
    run = subprocess.run(command, capture_output=True, check=True, text=True)  # noqa: S603
    loaded, validating = json.loads(run.stdout)
    assert "hitchid.model.hitch" in loaded
    assert [name for name in IDENTIFICATION if name in loaded] == []
    assert "hitchid.validation.validation" in validating
    assert "matplotlib" not in validating
