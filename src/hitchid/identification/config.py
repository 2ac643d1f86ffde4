"""Configuration of an identification, and its description by the keys of the settings file."""

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path

import jax

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.versions import installed_versions
from hitchid.data.campaign import Campaign
from hitchid.estimation import Search
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.rivals import RivalsConfig
from hitchid.identification.selection import AutoStructure
from hitchid.structures import ModelSpec


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
