"""Rivals of an identified model, trained after it."""

from pathlib import Path

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback
from hitchid._support.progress_display import shown
from hitchid.errors import InputError
from hitchid.estimation import SearchComparison
from hitchid.identification.campaign_job import CampaignJob
from hitchid.identification.config import check_campaign, identification_config
from hitchid.identification.identify import DEFAULT_STRUCTURES, PAPER_SPECS
from hitchid.identification.rivals import RivalsConfig
from hitchid.identification.settings_file import Settings, settings_of_model
from hitchid.logs.campaign import Campaign
from hitchid.model import Hitch

SEARCHES = SearchComparison()


@checks.named_arguments
@double_precision
def train_rivals(
    model: Hitch,
    campaign: Campaign,
    *,
    searches: SearchComparison | None = SEARCHES,
    progress: ProgressCallback | bool | None = True,
    checkpoints: str | Path | None = None,
) -> Hitch:
    """Return a model with all its rivals, trained on the tests that the model was identified from.

    They are ARX, OE, NARX, a black-box LSTM, the method of Sun et al. 2025, and baselines of other packages,
    with the settings and the seed of the identification.

    Args:
        model: an identified model.
        campaign: the tests that it was identified from, and those held out.
        searches: the global searches of the parameters that are compared; None compares none.
        progress, checkpoints: as for `identify`.

    Raises:
        InputError: the campaign is not that of the model, or an argument does not fit.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    settings: Settings = {
        **settings_of_model(model.provenance.settings),
        "seed": model.provenance.seed,
        "rivals": RivalsConfig(trained=True, searches=searches),
    }
    config = identification_config(DEFAULT_STRUCTURES, PAPER_SPECS, **settings)
    config = config.with_campaign_covariates(check_campaign(campaign))
    folder = None if checkpoints is None else checks.path(checkpoints, "checkpoints")
    job = CampaignJob.of(campaign, config, config.checkpoints(folder, campaign))
    if job.fingerprints != model.provenance.seen:
        raise InputError(
            "rivals are trained on the tests of their model: expected the logs and the split that it was "
            f"identified from, got {len(job.fingerprints & model.provenance.seen)} of "
            f"{len(model.provenance.seen)} of them and {len(job.fingerprints - model.provenance.seen)} others"
        )
    with shown(progress) as report:
        return job.with_rivals(model, report)
