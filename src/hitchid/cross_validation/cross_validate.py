"""Cross-validation of an identification by tests held out in turn."""

from collections.abc import Mapping

from hitchid._support import checks
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, subtask_progress
from hitchid.cross_validation.folds import Fold, divide
from hitchid.cross_validation.results import CrossValidation, FoldResult
from hitchid.data.campaign import Campaign
from hitchid.errors import HitchError
from hitchid.estimation import Search
from hitchid.identification import (
    CompensatorConfig,
    Identification,
    RivalsConfig,
    identify_many,
)
from hitchid.identification.arguments import Structures, check_campaign
from hitchid.identification.identify import DEFAULT_STRUCTURES, NO_DEAD_ZONES, TRAINING, WHALE
from hitchid.validation import validate

IDENTIFICATION_SHARE = 0.9  # of the work; the rest is validation (measured at default settings)


@checks.named_arguments
def cross_validate(
    campaign: Campaign,
    folds: int = 5,
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool = False,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> CrossValidation:
    """Identify a model without each fold of the tests in turn, and validate it on that fold.

    The tests of each direction are divided into folds by operating point, so that each test is held out once.
    The identification of a fold (dead zone, structure, parameters, training) gets none of its held-out tests.
    The campaign's own division into tests for identification and held-out tests is not used.

    Args:
        campaign: tests of one direction, or mixed cycles alone; ramps are used in every fold.
        folds: number of folds, from 2 to the number of operating points of each direction.
        structure, search, training, dead_zones, drift, rivals: as for `identify`, the same in all folds.
        seed: of the division into folds and of every other random draw.
        progress: called with the current task and the completed fraction of the work.

    Returns:
        Errors of each fold and pooled over all; a fold that fails has its error instead.

    Raises:
        InputError: a direction has fewer operating points than folds, or an argument does not fit.
        HitchError: every fold fails; the error is that of the first.
    """
    count = checks.integer(folds, "folds", minimum=2)
    divided = divide(check_campaign(campaign), count, checks.integer(seed, "seed"))
    report = progress or silent
    identifications = identify_many(
        [fold.training for fold in divided],
        structure=structure,
        search=search,
        training=training,
        dead_zones=dead_zones,
        drift=drift,
        rivals=rivals,
        seed=seed,
        progress=subtask_progress(report, 0.0, IDENTIFICATION_SHARE),
    )
    results = []
    for number, (fold, identification) in enumerate(zip(divided, identifications, strict=True), start=1):
        done = IDENTIFICATION_SHARE + (1 - IDENTIFICATION_SHARE) * (number - 1) / len(divided)
        report(ProgressUpdate(f"validation of fold {number}", done))
        results.append(_fold_result(number, fold, identification))
    errors = [result.error for result in results if result.error is not None]
    if len(errors) == len(results):
        raise errors[0]
    return CrossValidation(tuple(results))


def _fold_result(number: int, fold: Fold, identification: Identification | HitchError) -> FoldResult:
    tests = tuple(record.name for record in fold.held_out.records)
    if isinstance(identification, HitchError):
        return FoldResult(number, tests, error=identification)
    try:
        return FoldResult(number, tests, validate(identification.model, fold.held_out))
    except HitchError as error:
        return FoldResult(number, tests, error=error)
