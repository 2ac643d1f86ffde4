"""Whole mixed logs decide whether the network correction of free runs is used; its bands go with it."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

import handmade
from hitchid.identification import campaign_job
from hitchid.identification.campaign_job import CampaignJob
from hitchid.identification.result import ChannelTrace
from hitchid.logs.record import DISPLACEMENT, LIFTING, LOWERING


@dataclass(frozen=True)
class Trace(ChannelTrace):
    """A trace without what the judgement does not look at."""

    dead_zone: object = None
    phase1: object = None


@pytest.fixture
def judge(monkeypatch):
    """Return a function that judges a channel with a network, and one without, by errors over whole logs."""
    channels = [handmade.channel(LIFTING, free_run=True), handmade.channel(LOWERING)]
    model = handmade.with_bands(handmade.hitch_of(*channels), LIFTING, LOWERING)
    results = {own.direction: (own, Trace(uncertainty=model.uncertainty[own.direction])) for own in channels}

    def judged(with_it, without_it, cycles=("a log",)):
        monkeypatch.setattr(campaign_job, "cycle_errors", lambda *_: (with_it, without_it))
        campaign = SimpleNamespace(units={DISPLACEMENT: "mm"})
        job = SimpleNamespace(cycles=cycles, campaign=campaign, _hitch=lambda _: model)
        return results, CampaignJob.judge_on_cycles(job, results)

    return judged


def test_a_correction_that_makes_whole_logs_worse_goes_with_its_bands(judge):
    before, after = judge(2.0, 1.0)
    channel, trace = after[LIFTING]
    assert channel.speed_compensator is None
    assert trace.uncertainty.bands is None
    assert "2 mm with it, 1 mm without it; no bands" in trace.notices[0]
    assert after[LOWERING] is before[LOWERING]


@pytest.mark.parametrize("cycles", [("a log",), ()], ids=["better", "no mixed logs"])
def test_a_correction_stays_where_nothing_speaks_against_it(judge, cycles):
    before, after = judge(1.0 if cycles else 2.0, 1.5, cycles)
    assert after is before
