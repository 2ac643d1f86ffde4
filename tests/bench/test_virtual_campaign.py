"""The virtual bench's campaigns: what they hold, and that its limits are kept."""

import numpy as np
import pytest

from hitchid.bench import load_rig, rig_limits
from hitchid.bench.virtual_campaign import write_campaign
from hitchid.errors import OutputError
from hitchid.logs import read
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.text import read as read_csv

STROKE_MM = 1e3 * rig_limits(load_rig("nominal")).stroke_m


@pytest.fixture(scope="module")
def campaign_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench") / "logs"
    write_campaign(folder, tests={"ramp": 3, "prbs": 3}, seed=1)
    return folder


def test_a_bench_campaign_is_read_as_what_it_is(campaign_folder):
    campaign = read(campaign_folder)
    assert {r.kind for r in campaign.records} == {"ramp", "lifting", "lowering"}
    for mode in ("lifting", "lowering"):
        assert len(campaign.ramps(mode)) == 3
        assert len(campaign.of_kind(mode)) == 3
        assert all(len(record) == 1001 for record in campaign.of_kind(mode))
        # Dynamic tests move, and stay within the stroke.
        assert all(5.0 < np.ptp(record.displacement) < 0.95 * STROKE_MM for record in campaign.of_kind(mode))


def test_true_displacements_lie_beside_the_logs(campaign_folder):
    campaign = read(campaign_folder)
    for record in campaign.records:
        file = campaign_folder / "truth" / f"{record.name}.csv"
        truth = read_csv(file, ChannelSelection("time_s", ("displacement_true_mm",)))
        true = truth.channels["displacement_true_mm"].values
        assert true.size == len(record)
        # The sensors' error is within 0.3 % of full scale; noise stays within its share of that.
        assert np.max(np.abs(true - record.displacement)) < 2 * 0.003 * STROKE_MM


def test_one_seed_gives_one_campaign_bit_for_bit(campaign_folder, tmp_path):
    write_campaign(tmp_path / "again", tests={"ramp": 3, "prbs": 3}, seed=1)
    for path in sorted(campaign_folder.glob("*.csv")):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_a_campaign_that_stands_is_not_overwritten(campaign_folder):
    with pytest.raises(OutputError, match="exists already"):
        write_campaign(campaign_folder, tests={"prbs": 1})
