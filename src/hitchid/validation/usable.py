"""Which tests a model can be judged by: those that measured every covariate it requires."""

from dataclasses import replace

from hitchid.data.campaign import Campaign
from hitchid.data.left_out import refuse, sentences, sift
from hitchid.data.record import CYCLE, Record
from hitchid.model import Hitch


def with_covariates(campaign: Campaign, *models: Hitch) -> tuple[Campaign, tuple[str, ...]]:
    """Leave out the tests that lack a covariate one of the models requires, with sentences that say so.

    Raises:
        InputError: no test is left, or the campaign is strict and a test lacks one.
    """

    def complete(record: Record) -> Record:
        for model in models:
            for mode, channel in model.channels.items():
                if record.kind in (mode, CYCLE):
                    record.require(channel.benchmark.load)
        return record

    records = [(record.name, record) for record in campaign.records]
    usable, lacking = sift(records, complete, strict=campaign.strict)
    if lacking and not usable:
        refuse(lacking, "tests")
    return replace(campaign, records=tuple(usable)), sentences(lacking, len(records), "tests")
