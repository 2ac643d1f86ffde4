"""Nothing of a held-out test reaches a model, and nothing else is validated on."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, GAINS
from hitchid import identify, load, validate
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

FORM = ModelSpec(structure_named("integrator"))
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


def test_a_held_out_log_changes_nothing_but_the_validation(cycles, tmp_path):
    for name, records in (("one", cycles), ("two", [*cycles[:3], spoilt(cycles[3])])):
        identify(Campaign.of(records), **QUICK).save(tmp_path / name)
    for file in ("weights.safetensors", "rivals.safetensors", "trace.json", "model.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    model = load(tmp_path / "one")
    metrics = validate(model, Campaign.of(cycles)).metrics
    assert metrics["cycles"]["tests"] == ["cycle-3"]
    assert set(metrics["channels"]) == {LIFTING, LOWERING}
    for channel in metrics["channels"].values():
        assert channel["tests"]
        assert all(name.startswith("cycle-3#") for name in channel["tests"])
    with pytest.raises(InputError, match="was used for identification"):
        validate(model, Campaign.of(cycles[:3]))
    # A test that is not held out does change the model.
    other = identify(Campaign.of([spoilt(cycles[0]), *cycles[1:]]), **{**QUICK, "training": None}).model
    values = [hitch.channels[LIFTING].benchmark.values for hitch in (model, other)]
    assert np.all(values[0] != values[1])
