"""Campaigns over operating conditions: every combination, measured, and what cannot be is refused."""

import numpy as np
import pytest

from hitchid.bench import load_rig
from hitchid.bench.virtual_campaign import Conditions, write_campaign
from hitchid.errors import InputError
from hitchid.logs import read

RIG = load_rig("nominal")
CONDITIONS = Conditions((450.0, 1300.0), (5.0,), (0.0, 12.0))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conditions") / "logs"
    write_campaign(folder, tests={"prbs": 1}, directions=("lifting",), conditions=CONDITIONS, seed=2)
    return read(folder)


def test_every_combination_is_tested_and_measured(campaign):
    assert len(campaign.records) == 4
    assert campaign.covariates == ("consumer_l_min", "oil_degC", "pressure_bar")
    mean = {
        record.name: {name: np.mean(record.signals[name][:20]) for name in campaign.covariates}
        for record in campaign.records
    }
    heavy, light = (mean[f"lifting-01-{mass}kg-5C-12lpm"] for mass in (1300, 450))
    assert heavy["pressure_bar"] > 1.5 * light["pressure_bar"]
    # Noise of 0.3 °C and 0.1 l/min, of which the mean of twenty samples has less than a quarter.
    assert heavy["oil_degC"] == pytest.approx(5.0, abs=0.3)
    assert heavy["consumer_l_min"] == pytest.approx(12.0, abs=0.1)
    assert mean["lifting-01-450kg-5C-0lpm"]["consumer_l_min"] == pytest.approx(0.0, abs=0.1)


def test_oil_that_a_consumer_takes_does_not_lift(campaign):
    travel = {record.name: np.ptp(record.displacement) for record in campaign.records}
    assert travel["lifting-01-1300kg-5C-12lpm"] < travel["lifting-01-1300kg-5C-0lpm"]


def test_without_conditions_the_rig_stays_as_it_is():
    (condition,) = Conditions().of(RIG)
    assert condition.name == "1000kg-40C"
    assert float(condition.rig.supply.pump_flow) == pytest.approx(float(RIG.supply.pump_flow), rel=1e-12)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        (Conditions((0.0,)), "implements_kg: expected .*0"),
        (Conditions((), (np.nan,)), "oil_c: expected"),
        (Conditions((), (), (20.0,)), r"consumer_l_min: expected from 0 to less than the pump's 20 l/min"),
        (Conditions((), (), (-1.0,)), "consumer_l_min: expected .*got -1"),
    ],
)
def test_conditions_that_cannot_be_are_refused(conditions, message):
    with pytest.raises(InputError, match=message):
        list(conditions.of(RIG))
