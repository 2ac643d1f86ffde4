"""Checks of the arguments of an identification, and the configuration made from them."""

from collections.abc import Mapping
from types import MappingProxyType

from hitchid._support import checks
from hitchid.data.campaign import Campaign
from hitchid.data.record import DIRECTIONS
from hitchid.errors import InputError
from hitchid.estimation import DifferentialEvolution, MultiStart, Search, Whale
from hitchid.identification.config import IdentificationConfig
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.rivals import RivalsConfig
from hitchid.identification.selection import AutoStructure
from hitchid.structures import ModelSpec, registered_structures, structure_named

LARGEST_SEED = 2**32 - 1  # upper limit of the seeds of NumPy's and JAX's generators
AUTOMATIC = "automatic"  # the name of the default choice of each direction
SEARCHES: Mapping[str, Search] = MappingProxyType(
    {search.name: search for search in (Whale(), DifferentialEvolution(), MultiStart())}
)
CAMPAIGN = 'a campaign as hitchid.read("logs") returns it'

Structures = ModelSpec | AutoStructure | str | Mapping[str, ModelSpec | AutoStructure | str]


def check_campaign(value: object) -> Campaign:
    """Return a campaign; raises InputError for anything else, such as the folder to read it from."""
    return checks.instance(value, Campaign, "campaign", CAMPAIGN)


def identification_config(
    default_specs: Mapping[str, ModelSpec | AutoStructure],
    paper_specs: Mapping[str, ModelSpec],
    *,
    structure: Structures,
    search: Search | str,
    training: CompensatorConfig | None,
    dead_zones: Mapping[str, float],
    drift: bool,
    rivals: RivalsConfig | bool | None,
    seed: int,
) -> IdentificationConfig:
    """Return the configuration of an identification; see `identify`.

    Args:
        default_specs: direction to its model specification or automatic choice, where `structure` has none.
        paper_specs: direction to the paper's model specification.
        structure, search, training, dead_zones, drift, rivals, seed: see `identify`.

    Raises:
        InputError: an argument has the wrong type, or a value outside its limits.
    """
    if isinstance(search, str):
        search = SEARCHES[checks.one_of(search, SEARCHES, "search")]
    checks.instance(
        search, Search, "search", f"one of {', '.join(SEARCHES)}, or a Search of hitchid.estimation"
    )
    checks.instance(training, (CompensatorConfig, type(None)), "training", "CompensatorConfig or None")
    checks.instance(drift, bool, "drift", "True or False")
    if checks.integer(seed, "seed") > LARGEST_SEED:
        raise checks.input_error("seed", f"at most {LARGEST_SEED}", seed)
    for direction, dead_zone in checks.mapping_of(dead_zones, DIRECTIONS, "dead_zones").items():
        if checks.number(dead_zone, f"dead_zones, {direction}") < 0:
            raise InputError(f"dead_zones, {direction}: expected at least 0, got {dead_zone}")
    if isinstance(structure, str | ModelSpec | AutoStructure):
        structure = dict.fromkeys(DIRECTIONS, structure)
    structures = checks.mapping_of(structure, DIRECTIONS, "structure")
    specs = {
        direction: _spec_of(structures.get(direction, AUTOMATIC), direction, default_specs[direction])
        for direction in DIRECTIONS
    }
    return IdentificationConfig(
        specs, paper_specs, search, training, dead_zones, drift, RivalsConfig.of(rivals), seed
    )


def _spec_of(value: object, direction: str, default: ModelSpec | AutoStructure) -> ModelSpec | AutoStructure:
    if value == AUTOMATIC:
        return default
    if isinstance(value, str):
        return ModelSpec(structure_named(value))
    names = ", ".join((AUTOMATIC, *registered_structures()))
    required = f"one of {names}, or a ModelSpec or AutoStructure"
    return checks.instance(value, (ModelSpec, AutoStructure), f"structure, {direction}", required)
