"""Records, campaigns, models and validations: equal by content, copied, sent to another process."""

import copy
import multiprocessing
import pickle
from dataclasses import replace

import jax
import numpy as np
import pytest

import hitchid
from handmade import hitch, with_bands
from hitchid.errors import LogError
from hitchid.logs.campaign import Campaign
from hitchid.logs.unification import LeftOut
from hitchid.model import Information, LoadOfTest, LoadScatter, Provenance, TwoModes
from hitchid.model.provenance import DifferenceTest
from hitchid.validation import Validation
from hitchid.validation.results import Accuracy, ChannelResult, ModelFigures, RunFigures
from report.reported import ESTIMATES, characteristics, horizons, known_estimates, predictions

COPIES = [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))]


@pytest.fixture(scope="module")
def record(make_record):
    """Return a lifting test."""
    command = np.where(np.arange(60) > 5, 0.5, 0.0)
    return make_record(100.0 + np.cumsum(command), command, 0 * command, name="up-1")


@pytest.fixture(scope="module")
def campaign(record):
    """Return a campaign with a log that is left out."""
    records = (record, replace(record, name="up-2", kind="lifting"))
    return Campaign(records, ("up-2",), left_out=(LeftOut("x", LogError("x.csv", "broken", line=1)),))


@pytest.fixture(scope="module")
def model():
    """Return a model with every part."""
    provenance = Provenance(
        {"lifting": ("up-1",)}, seen=frozenset("ab"), settings={"search": {"name": "whale", "n": [1]}}
    )
    whole = hitch(
        "integrator-second-order",
        compensated=True,
        free_run=True,
        shape=True,
        dead_time_s=0.03,
        baselines=True,
        provenance=provenance,
    )
    whole = with_bands(whole, "lifting", "lowering")
    estimates = known_estimates(
        *(estimate for estimate in ESTIMATES if estimate.name in ("gain", "natural_frequency"))
    )
    estimates = replace(estimates, correlation=((1.0, 0.3), (0.3, 1.0)))
    speeds = replace(characteristics(), load="pressure")
    by_direction = {
        direction: replace(
            entry,
            benchmark=estimates,
            characteristics=speeds,
            information=Information(
                ("gain",), (1.0,), ((1.0,),), ((0.1 + 0.2,),), ((0.0,),), (1.0,), 1, False, 5, 9.5
            ),
            load_scatter=LoadScatter(0.04, (0.02, None), 0.1, (LoadOfTest("up-1", 0.01, (-1.0, 1 / 3)),)),
        )
        for direction, entry in whole.uncertainty.items()
    }
    units = {**whole.units, "pressure": "bar"}
    modes = TwoModes(True, 1.0, 0.5, 12, DifferenceTest(10.0, ("gain",), 9.0, 1e-3))
    return replace(whole, units=units, uncertainty=by_direction, two_modes=modes, drift=-0.1)


@pytest.fixture(scope="module")
def validation(model, campaign):
    """Return a validation."""
    figures = RunFigures(0.4, 0.3, 0.99, 97.0, 1.2, 0.9)
    accuracy = Accuracy({"greybox": ModelFigures(figures, figures)}, horizons(), {}, predictions())
    return Validation("mm", {"lifting": ChannelResult(accuracy, {})}, None, None, (), model, campaign)


@pytest.mark.parametrize("name", ["record", "campaign", "model", "validation"])
@pytest.mark.parametrize("copied", COPIES, ids=["copy", "deepcopy", "pickle"])
def test_a_copy_is_equal(request, name, copied):
    value = request.getfixturevalue(name)
    again = copied(value)
    assert again == value
    assert hash(again) == hash(value)
    assert repr(again) == repr(value)


def test_a_copy_of_a_record_is_read_only(record):
    again = copy.deepcopy(record)
    with pytest.raises(ValueError, match="read-only"):
        again.displacement[0] = 0.0
    with pytest.raises(TypeError):
        again.units["displacement"] = "m"


def test_one_sample_or_number_makes_the_difference(record, campaign, model, validation):
    moved = replace(record, signals={**record.signals, "displacement": record.displacement + 1e-12})
    assert record != moved
    assert campaign != replace(campaign, records=(moved, campaign[1]))
    assert campaign != replace(campaign, left_out=())
    assert model != replace(model, drift=0.0)
    lifting = model.channels["lifting"]
    stronger = replace(lifting, benchmark=lifting.benchmark.with_gain(1 + 1e-12))
    assert model != replace(model, channels={**model.channels, "lifting": stronger})
    assert validation != replace(validation, channels={})
    assert len({record, moved, copy.deepcopy(record)}) == 2


def test_a_model_read_from_disk_equals_the_saved_one(model, tmp_path):
    hitchid.save(model, tmp_path / "model")
    loaded = hitchid.load(tmp_path / "model")
    assert loaded == model
    assert hash(loaded) == hash(model)


def test_a_model_that_worked_is_copied_without_double_precision(record):
    worker = hitch("integrator-first-order")
    simulated = worker.simulate(record)  # leaves compiled functions with the model
    with jax.enable_x64(False):
        again = pickle.loads(pickle.dumps(worker))
        copied = copy.deepcopy(worker)
    assert again.channels["lifting"].benchmark.values.dtype == np.float64
    np.testing.assert_array_equal(again.simulate(record), simulated)
    np.testing.assert_array_equal(copied.simulate(record), simulated)


def test_a_model_works_in_a_process_of_its_own(record, campaign):
    worker = hitch("integrator-first-order")
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        simulated = pool.apply(worker.simulate, (record,))
        again = pool.apply(copy.copy, ((record, campaign, worker),))
    np.testing.assert_array_equal(simulated, worker.simulate(record))
    assert again == (record, campaign, worker)
