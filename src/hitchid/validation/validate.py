"""Validation: a model and its baselines on tests that the identification did not use."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid.data.campaign import Campaign
from hitchid.data.record import CYCLE, DISPLACEMENT, Record
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model import Hitch, Rivals
from hitchid.validation.channels import channel_result
from hitchid.validation.cycles import cycle_result
from hitchid.validation.notices import (
    baseline_notices,
    channel_notices,
    cycle_notices,
    set_by_hand_notices,
)
from hitchid.validation.results import ChannelResult
from hitchid.validation.usable import with_covariates
from hitchid.validation.validation import Validation

WORKERS = 2  # threads for directions and cycles; chosen


@checks.named_arguments
@double_precision
def validate(
    model: Hitch,
    campaign: Campaign,
    *,
    segmentation_dead_zones: Mapping[str, float] | None = None,
    progress: ProgressCallback | None = None,
) -> Validation:
    """Compare a model with the tests of a campaign that its identification did not use.

    Free run: commands and initial displacement only, for the whole test. One step and horizon h: measured
    displacement up to 1 and h samples before; the first h samples of a test are left out. The baselines are
    the benchmark alone, persistence (the last measured displacement), ARX, OE, NARX, a black-box LSTM, and
    the transfer function and the grey box of Sun et al. 2025. Models that only run freely (benchmark, OE,
    LSTM, transfer function) are simulated over a horizon from the last measured displacement. Baselines use
    the same covariate that the grey box may use, and keep to the same end stop and limits.

    Args:
        model: an identified hitch.
        campaign: logs; those the identification used are left out, recognised by their content, and those
            that lack a covariate the model requires.
        segmentation_dead_zones: direction to the dead zone by which mixed cycles are cut into strokes where
            there are no single-direction tests; by default the model's own.
        progress: called with the current task and the completed fraction of the work.

    Raises:
        InputError: the identification used every test, none fits the model's channels, or a unit has another
            dimension than the model's.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    checks.instance(campaign, Campaign, "campaign", 'a campaign as hitchid.read("logs") returns it')
    report = progress or silent
    usable, lacking = with_covariates(campaign, model)
    single_direction = usable
    if not usable.directions:
        dead_zones = segmentation_dead_zones or model.segmentation_dead_zones(usable.units)
        single_direction = usable.segmented(dead_zones)
    unit = single_direction.records[0].unit
    factor = conversion_factor(model.units[DISPLACEMENT], unit, "displacement")
    unseen_cycles = []
    if len(model.channels) > 1:
        unseen_cycles = [model.to_model_units(record) for record in _unseen(model, usable.of_kind(CYCLE))]
    channels: dict[str, ChannelResult] = {}
    cycles, notices = None, [*lacking]
    with ThreadPoolExecutor(WORKERS) as pool:
        cycle_job = (
            pool.submit(double_precision(cycle_result), model, unseen_cycles, factor)
            if unseen_cycles
            else None
        )
        jobs = {
            direction: pool.submit(
                _validate_direction, model, direction, single_direction.of_kind(direction), factor
            )
            for direction in single_direction.directions
        }
        for number, (direction, future) in enumerate(jobs.items()):
            report(ProgressUpdate(f"{direction}: horizons and free run", number / (len(jobs) + 1)))
            result, direction_notices = future.result()
            notices += direction_notices
            if result is not None:
                channels[direction] = result
        report(ProgressUpdate("cycles", len(jobs) / (len(jobs) + 1)))
        if cycle_job is not None:
            cycles = cycle_job.result()
            notices += cycle_notices(model, cycles, factor)
    if not channels and cycles is None:
        raise InputError(
            "every test of these logs was used for identification, or is in a direction "
            "that the model does not have; expected at least one other test"
        )
    if not model.has_trained_rivals:
        notices.append(
            "no trained rivals to compare with: hitchid rivals MODEL LOGS trains OE, NARX, a black-box LSTM "
            "and the paper's grey box"
        )
    mode_test = model.two_modes
    if mode_test is not None:
        notices.append(mode_test.sentence)
    return Validation(unit, channels, cycles, mode_test, tuple(notices), model, campaign)


@double_precision
def _validate_direction(
    model: Hitch, direction: str, records: Sequence[Record], factor: float
) -> tuple[ChannelResult | None, list[str]]:
    """Return the results of one direction, None without unseen tests, and its notices."""
    unseen = _unseen(model, records)
    if direction not in model.channels:
        return None, [f"{len(unseen)} {direction} tests are left out: the model has no {direction} channel"]
    if not unseen:
        return None, []
    tests = [model.to_model_units(record) for record in unseen]
    channel, rivals = model.channels[direction], model.rivals.get(direction, Rivals())
    result = channel_result(channel, tests, factor, model.uncertainty.get(direction), rivals)
    notices = channel_notices(direction, result.accuracy, channel, tests)
    notices = [*notices, *baseline_notices(direction, rivals, tests)]
    return result, [*set_by_hand_notices(model, direction), *notices]


def _unseen(model: Hitch, records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record.fingerprint not in model.provenance.seen]
