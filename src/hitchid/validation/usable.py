"""Tests that a model can be validated on: those with every covariate it requires."""

from dataclasses import replace

from hitchid.data.campaign import Campaign
from hitchid.data.left_out import left_out_notices, refuse, split_usable
from hitchid.data.record import CYCLE, Record
from hitchid.model import Hitch


def with_covariates(campaign: Campaign, *models: Hitch) -> tuple[Campaign, tuple[str, ...]]:
    """Return a campaign without the tests that lack a covariate one of the models requires, and notices.

    Raises:
        InputError: no test is left, or the campaign is strict and a test lacks a covariate.
    """

    def complete(record: Record) -> Record:
        for model in models:
            for direction, channel in model.channels.items():
                if record.kind in (direction, CYCLE):
                    record.require(channel.benchmark.covariates)
        return record

    records = [(record.name, record) for record in campaign.records]
    usable, lacking = split_usable(records, complete, strict=campaign.strict)
    if lacking and not usable:
        refuse(lacking, "tests")
    notices = left_out_notices(lacking, len(records), "tests")
    return replace(campaign, records=tuple(usable)), tuple(map(str, notices))
