"""The arguments of an identification, checked and put together."""

from collections.abc import Mapping

from hitchid._support import checks
from hitchid.data.campaign import Campaign
from hitchid.data.record import MODES
from hitchid.errors import InputError
from hitchid.estimation import Comparison, Search
from hitchid.identification.case import Question
from hitchid.identification.phase2 import Training
from hitchid.identification.selection import Automatic
from hitchid.structures import Form, structure_named

LARGEST_SEED = 2**32 - 1
CAMPAIGN = 'a campaign as hitchid.read("logs") returns it'


def campaign_of(value: object) -> Campaign:
    """Return a campaign; raises InputError for anything else, such as the folder to read it from."""
    return checks.instance(value, Campaign, "campaign", CAMPAIGN)


def question_of(
    chosen: Mapping[str, Form | Automatic],
    paper: Mapping[str, Form],
    *,
    structure: Mapping[str, Form | Automatic | str],
    search: Search,
    training: Training | None,
    dead_zones: Mapping[str, float],
    drift: bool,
    comparison: Comparison | None,
    seed: int,
) -> Question:
    """Return what is asked of a campaign; see `identify`.

    Args:
        chosen: direction to how its form is chosen where `structure` has none.
        paper: direction to the paper's form.
        structure, search, training, dead_zones, drift, comparison, seed: as they were handed in.

    Raises:
        InputError: one of them is not what `identify` takes.
    """
    checks.instance(search, Search, "search", "Whale, DifferentialEvolution or MultiStart")
    checks.instance(training, (Training, type(None)), "training", "Training or None")
    checks.instance(comparison, (Comparison, type(None)), "comparison", "Comparison or None")
    checks.instance(drift, bool, "drift", "True or False")
    if checks.whole(seed, "seed") > LARGEST_SEED:
        raise checks.refusal("seed", f"at most {LARGEST_SEED}", seed)
    for mode, zone in checks.keyed(dead_zones, MODES, "dead_zones").items():
        if checks.number(zone, f"dead_zones, {mode}") < 0:
            raise InputError(f"dead_zones, {mode}: required at least 0, came {zone}")
    given = checks.keyed(structure, MODES, "structure")
    forms = {mode: _form_of(given.get(mode, chosen[mode]), mode) for mode in MODES}
    return Question(forms, paper, search, training, dead_zones, drift, comparison, seed)


def _form_of(value: object, mode: str) -> Form | Automatic:
    if isinstance(value, str):
        return Form(structure_named(value))
    required = "the name of a structure, Form or Automatic"
    return checks.instance(value, (Form, Automatic), f"structure, {mode}", required)
