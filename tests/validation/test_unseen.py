"""Nothing of a held-out test reaches a model, and nothing else is validated on."""

import json
from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, GAINS
from hitchid import identify, validate
from hitchid.errors import InputError
from hitchid.identification import (
    AdamConfig,
    CompensatorConfig,
    ModelSpec,
    MultiStart,
    SpeedCompensatorConfig,
)
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.structures import structure_named
from truth import held, levels

FORM = ModelSpec(structure_named("integrator-first-order"))
QUICK = {
    "structure": {LIFTING: FORM, LOWERING: FORM},
    "search": MultiStart(evaluations=30),
    "rivals": False,
    "training": CompensatorConfig(
        hidden=4, window=10, adam=AdamConfig(epochs=5, patience=5), free_run=SpeedCompensatorConfig(units=2)
    ),
}


def spoilt(record):
    """Return a record whose displacement is nothing like what was measured."""
    nonsense = 3.0 * record.displacement[::-1] + 17.0
    return replace(record, signals={**record.signals, "displacement": nonsense})


@pytest.fixture
def lifting_tests(make_record):
    rng = np.random.default_rng(0)
    records = []
    for number in range(5):
        command = levels(rng, 200, low=0.4)
        travel = held([30.0], [0.1, 1.0, 0.0], np.maximum(command - 0.35, 0))
        measured = 80.0 + travel + 0.02 * rng.standard_normal(200)
        records.append(make_record(measured, command, name=f"lifting-{number}"))
    return records


def test_a_held_out_log_changes_neither_weights_nor_parameters(lifting_tests, tmp_path):
    for name, records in (("one", lifting_tests), ("two", [*lifting_tests[:4], spoilt(lifting_tests[4])])):
        identify(Campaign.of(records), **QUICK).save(tmp_path / name)
    one, two = tmp_path / "one", tmp_path / "two"
    for file in ("weights.safetensors", "rivals.safetensors", "trace.json"):
        assert (one / file).read_bytes() == (two / file).read_bytes()
    assert (one / "model.json").read_bytes() == (two / "model.json").read_bytes()
    described = json.loads((one / "model.json").read_bytes())
    assert described["split"]["held_out"] == {"lifting": ["lifting-4"]}
    assert described["split"]["identification"] == {"lifting": [f"lifting-{n}" for n in range(4)]}
    # The two campaigns do differ, and a test that is not held out does change the model.
    spoilt_first = Campaign.of([spoilt(lifting_tests[0]), *lifting_tests[1:]])
    other = identify(spoilt_first, **{**QUICK, "training": None})
    values = other.model.channels[LIFTING].benchmark.values
    assert np.all(np.asarray(values) != described["channels"]["lifting"]["values"])


@pytest.fixture
def cycles(make_record):
    rng = np.random.default_rng(0)
    records = []
    for number in range(4):
        rest = np.zeros(80)
        up, down = (np.concatenate([rest, levels(rng, 120, low=0.5)]) for _ in range(2))
        lifting, lowering = np.concatenate([up, 0 * down, up]), np.concatenate([0 * up, down, 0 * up])
        speed = GAINS[LIFTING] * np.maximum(lifting - DEAD_ZONES[LIFTING], 0)
        speed -= GAINS[LOWERING] * np.maximum(lowering - DEAD_ZONES[LOWERING], 0)
        measured = 80.0 + held([1.0], [0.1, 1.0, 0.0], speed) + 0.02 * rng.standard_normal(speed.size)
        records.append(make_record(measured, lifting, lowering, name=f"cycle-{number}"))
    return records


@pytest.mark.long
def test_of_mixed_logs_only_strokes_of_held_out_cycles_are_validated_on(cycles, tmp_path):
    form = ModelSpec(structure_named("integrator"))
    settings = {**QUICK, "structure": {LIFTING: form, LOWERING: form}, "training": None}
    found = {}
    for name, records in (("one", cycles), ("two", [*cycles[:3], spoilt(cycles[3])])):
        found[name] = identify(Campaign.of(records), **settings)
        found[name].save(tmp_path / name)
    for file in ("weights.safetensors", "rivals.safetensors", "trace.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    metrics = validate(found["one"].model, Campaign.of(cycles)).metrics
    assert metrics["cycles"]["tests"] == ["cycle-3"]
    assert set(metrics["channels"]) == {LIFTING, LOWERING}
    for channel in metrics["channels"].values():
        assert channel["tests"]
        assert all(name.startswith("cycle-3#") for name in channel["tests"])
    with pytest.raises(InputError, match="was used for identification"):
        validate(found["one"].model, Campaign.of(cycles[:3]))
