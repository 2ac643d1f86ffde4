"""Identification of a campaign: dead zones, phase 1, then phase 2, for both directions in parallel."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from hitchid._support.checks import named_arguments, path, tuple_of
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback
from hitchid._support.progress_display import shown
from hitchid.data.campaign import Campaign
from hitchid.data.record import LIFTING, LOWERING
from hitchid.errors import HitchError
from hitchid.estimation import Search, Whale
from hitchid.identification.arguments import CAMPAIGN, Structures, check_campaign, identification_config
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.pipeline import PhysicsCallback, run_pipeline
from hitchid.identification.result import Identification
from hitchid.identification.rivals import RivalsConfig
from hitchid.identification.selection import AutoStructure
from hitchid.structures import ModelSpec, structure_named

PAPER_SPECS: Mapping[str, ModelSpec] = MappingProxyType(
    {
        LIFTING: ModelSpec(structure_named("integrator-second-order")),
        LOWERING: ModelSpec(structure_named("first-order-lag")),
    }
)
# By default the choice starts from integrators, which hold their place without a command.
DEFAULT_STRUCTURES: Mapping[str, AutoStructure] = MappingProxyType(
    {
        LIFTING: AutoStructure(PAPER_SPECS[LIFTING]),
        LOWERING: AutoStructure(ModelSpec(structure_named("integrator-first-order"))),
    }
)
WHALE = Whale()
TRAINING = CompensatorConfig()
NO_DEAD_ZONES: Mapping[str, float] = MappingProxyType({})


@named_arguments
@double_precision
def identify(
    campaign: Campaign,
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool = False,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | bool | None = True,
    checkpoints: str | Path | None = None,
    on_physics: PhysicsCallback | None = None,
) -> Identification:
    """Identify a grey-box model from the tests of a campaign that are not held out.

    Phase 1 finds each benchmark by a global search and least squares, phase 2 trains each compensator on the
    error of its frozen benchmark (Sun et al. 2025, sec. 2.4.2). Tests of one direction are used where there
    are any; a campaign of mixed cycles alone is cut into strokes.

    Args:
        campaign: tests; ramps, where there are any, give the dead zones.
        structure: name of a structure or form of a benchmark, for both directions or by direction;
            "automatic", the default, or `AutoStructure` for the choice by free run on operating points held
            out in turn; `PAPER_SPECS` are the paper's.
        search: the global search of phase 1: "whale", "differential-evolution" or "multi-start", or one with
            settings, `Whale`, `DifferentialEvolution` or `MultiStart`.
        training: settings of phase 2; None identifies benchmarks alone.
        dead_zones: direction to dead zone, in the command's unit, where it is known.
        drift: whether the drift of a held piston is identified; otherwise it is zero.
        rivals: models that are fitted for comparison. False for those that cost little, ARX and the paper's
            transfer function; True for all, which takes longer than the model and may follow later, see
            `train_rivals`; None for none.
        seed: every random draw comes from it.
        progress: True for a bar in a terminal or a notebook, False for none, or a function that is called
            with what is being done and the fraction of all work that is done.
        checkpoints: folder where finished searches and trainings are kept; with those of a run that was
            stopped, it continues from there to the same model. None keeps none.
        on_physics: called with the physics model as soon as there is one, before corrections are trained;
            the sentence that it returns is shown with the progress.

    Raises:
        InputError: there is no test of one direction, all are held out or cannot be used, or an
            argument does not fit.
        FitError: the identification could not be carried out on these data.
    """
    config = identification_config(
        DEFAULT_STRUCTURES,
        PAPER_SPECS,
        structure=structure,
        search=search,
        training=training,
        dead_zones=dead_zones,
        drift=drift,
        rivals=rivals,
        seed=seed,
    )
    folder = None if checkpoints is None else path(checkpoints, "checkpoints")
    with shown(progress) as report:
        (result,) = run_pipeline([check_campaign(campaign)], config, report, folder, on_physics)
    if isinstance(result, HitchError):
        raise result
    return result


@named_arguments
@double_precision
def identify_many(
    campaigns: Sequence[Campaign],
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool = False,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | bool | None = True,
) -> tuple[Identification | HitchError, ...]:
    """Identify a model from each of many campaigns, such as those of a fleet, in one process.

    Each becomes the model that `identify` finds. Programs are compiled once for all campaigns of like shape,
    and all cores work on them.

    Args:
        campaigns: of one machine each.
        structure, search, training, dead_zones, drift, rivals, seed: as for `identify`, the same for all.
        progress: as for `identify`.

    Returns:
        In the order of the campaigns the identification, or the error with which it ended; an error does not
        affect the others.
    """
    config = identification_config(
        DEFAULT_STRUCTURES,
        PAPER_SPECS,
        structure=structure,
        search=search,
        training=training,
        dead_zones=dead_zones,
        drift=drift,
        rivals=rivals,
        seed=seed,
    )
    checked_campaigns = tuple_of(campaigns, Campaign, "campaigns", f"several, each {CAMPAIGN}")
    with shown(progress) as report:
        return run_pipeline(checked_campaigns, config, report)
