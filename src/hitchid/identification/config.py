"""Configuration of an identification, and its description by the keys of the settings file."""

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType

import jax

from hitchid._support import checks
from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.jax_setup import installed_versions
from hitchid.errors import InputError
from hitchid.estimation import DifferentialEvolution, MultiStart, Search, Whale
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.rivals import RivalsConfig
from hitchid.identification.selection import AutoStructure
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import DIRECTIONS
from hitchid.structures import ModelSpec, registered_structures, structure_named


@dataclass(frozen=True)
class IdentificationConfig:
    """Configuration of an identification; see `identify`.

    Attributes:
        specs: direction to the model specification of its benchmark, or its automatic choice.
        paper_specs: direction to the paper's model specification.
        search, training, dead_zones, drift, rivals, seed: see `identify`.
    """

    specs: Mapping[str, ModelSpec | AutoStructure]
    paper_specs: Mapping[str, ModelSpec]
    search: Search
    training: CompensatorConfig | None
    dead_zones: Mapping[str, float]
    drift: bool
    rivals: RivalsConfig
    seed: int

    def with_campaign_covariates(self, campaign: Campaign) -> "IdentificationConfig":
        """Return the configuration with the campaign's covariates where an automatic choice names none."""
        return replace(
            self,
            specs={
                direction: _with_covariates(spec, campaign.covariates)
                for direction, spec in self.specs.items()
            },
        )

    def describe(self) -> dict[str, object]:
        """Return the configuration as JSON values."""
        return {
            "structure": {direction: _describe_spec(spec) for direction, spec in self.specs.items()},
            "search": _describe_search(self.search),
            "training": _describe_training(self.training),
            "dead_zones": dict(self.dead_zones),
            "drift": self.drift,
        }

    @property
    def stamp(self) -> dict[str, object]:
        """All that the outcome depends on beside the logs, as JSON values."""
        searches = self.rivals.searches
        return {
            "asked": {**self.describe(), "forms": repr(self.specs), "seed": self.seed},
            "search": repr(self.search),
            "training": repr(self.training),
            "rivals": repr(
                replace(self.rivals, searches=searches and replace(searches, checkpoints=DISABLED))
            ),
            "machine": f"{platform.machine()} {jax.default_backend()}",
            "versions": installed_versions(),
        }

    def checkpoints(self, folder: Path | None, campaign: Campaign) -> Checkpoints:
        """Return the checkpoints of runs with the same logs, settings, versions and kind of machine."""
        if folder is None:
            return DISABLED
        return Checkpoints.of_run(folder, {**self.stamp, "campaign": campaign.digest})


def _with_covariates(
    spec: ModelSpec | AutoStructure, covariates: tuple[str, ...]
) -> ModelSpec | AutoStructure:
    if isinstance(spec, AutoStructure) and not spec.covariate_names:
        return replace(spec, covariate_names=covariates)
    return spec


def _describe_spec(spec: ModelSpec | AutoStructure) -> dict[str, object]:
    if isinstance(spec, AutoStructure):
        return {"automatic": True, "load": list(spec.covariate_names)}
    return {
        "structure": spec.structure.name,
        "dead_time": spec.dead_time,
        "curve": spec.valve_curve,
        "spool": spec.spool_dynamics,
        "slope": spec.stroke_gain_linear,
        "position": spec.stroke_gain_quadratic,
        "load": list(spec.covariate_names),
        "load_dynamics": any(effects.dynamics for effects in spec.covariates),
        "load_quadratic": any(effects.quadratic for effects in spec.covariates),
        "bounds": {name: list(limits) for name, limits in spec.bounds.items()},
    }


def _describe_search(search: Search) -> dict[str, object]:
    """Return the settings of a search by the keys of the settings file, as far as it has them."""
    values = asdict(search) if is_dataclass(search) else {}
    return {"method": search.name, **{key: value for key, value in _flat(values).items() if key != "name"}}


def _describe_training(training: CompensatorConfig | None) -> dict[str, object]:
    """Return the settings of the training by the keys of the settings file, as far as it has them."""
    if training is None:
        return {"compensator": False}
    free_run = training.free_run
    return {
        "compensator": True,
        "hidden": training.hidden,
        "window": training.window,
        **asdict(training.adam),
        "free_run": free_run is not None,
        **({} if free_run is None else {f"free_run_{key}": value for key, value in asdict(free_run).items()}),
    }


def _flat(values: Mapping[str, object]) -> dict[str, object]:
    """Return a mapping with the entries of nested mappings in their place."""
    flat = {}
    for key, value in values.items():
        flat |= _flat(value) if isinstance(value, Mapping) else {key: value}
    return flat


# Checks of the arguments of an identification, and the configuration made from them.

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
