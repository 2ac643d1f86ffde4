"""The settings file of `hitchid identify --config`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from pydantic import Field, ValidationError

from hitchid.errors import InputError, SettingsError
from hitchid.estimation import (
    EVALUATIONS,
    DifferentialEvolution,
    MultiStart,
    Search,
    SearchComparison,
    Whale,
    WhaleConfig,
)
from hitchid.estimation.training import AdamConfig
from hitchid.identification.config import (
    AUTOMATIC,
    DEFAULT_STRUCTURES,
    LARGEST_SEED,
    IdentificationConfig,
    RivalsConfig,
)
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.selection import AutoStructure
from hitchid.identification.speed_training import SpeedCompensatorConfig
from hitchid.logs.record import DIRECTIONS
from hitchid.logs.signal_map import StrictSettings, describe_settings, parse_settings
from hitchid.model.schema import KeptSettings
from hitchid.structures import CovariateEffects, ModelSpec, structure_named

Count = Annotated[int, Field(ge=1, le=10**9)]


class Settings(TypedDict, total=False):
    """Arguments of `identify`."""

    structure: Mapping[str, ModelSpec | AutoStructure]
    search: Search
    training: CompensatorConfig | None
    dead_zones: Mapping[str, float]
    drift: bool | None
    rivals: RivalsConfig | bool | None
    seed: int


class ChannelSection(StrictSettings):
    """`[lifting]` and `[lowering]`."""

    structure: str = AUTOMATIC
    dead_time: bool = False
    curve: bool = False
    spool: bool = False
    slope: bool = False
    position: bool = False
    load: str | tuple[str, ...] = ()
    load_dynamics: bool = False
    load_quadratic: bool = False
    without: tuple[str, ...] = ()
    dead_zone: float | None = Field(default=None, ge=0)
    bounds: dict[str, tuple[float, float]] = Field(default_factory=dict)

    @property
    def covariate_names(self) -> tuple[str, ...]:
        """Names of the covariates that parameters may vary with."""
        return (self.load,) if isinstance(self.load, str) else tuple(dict.fromkeys(self.load))

    def spec(self, direction: str) -> ModelSpec | AutoStructure:
        """Return the structure, or its choice; raises InputError where a choice has keys that it decides."""
        if self.structure == AUTOMATIC:
            decided = self.model_fields_set - {"structure", "load", "dead_zone"}
            if decided:
                raise InputError(
                    f"{direction}: structure '{AUTOMATIC}' determines "
                    f"{' and '.join(sorted(decided))} itself; remove these keys, or name a structure"
                )
            return replace(DEFAULT_STRUCTURES[direction], covariate_names=self.covariate_names)
        effects = (self.load_dynamics, self.load_quadratic)
        return ModelSpec(
            structure_named(self.structure),
            self.dead_time,
            self.bounds,
            valve_curve=self.curve,
            spool_dynamics=self.spool,
            stroke_gain_linear=self.slope,
            stroke_gain_quadratic=self.position,
            covariates=tuple(CovariateEffects(name, *effects) for name in self.covariate_names),
            without=self.without,
        )


class ChoiceSection(StrictSettings):
    """`[choice]`."""

    repeats: int = Field(default=0, ge=0, le=1000)


class SearchSection(StrictSettings):
    """`[search]`."""

    method: Literal["whale", "differential-evolution", "multi-start"] = "whale"
    evaluations: Count = EVALUATIONS
    population: Count | None = None
    stagnation: Count | None = None
    per_dimension: bool = True
    compare: bool | None = None

    def search(self) -> Search:
        """Return the search of these settings."""
        if self.method == "multi-start":
            return MultiStart(evaluations=self.evaluations)
        if self.method == "differential-evolution":
            members = self.population or DifferentialEvolution.population
            return DifferentialEvolution(evaluations=self.evaluations, population=members)
        population = self.population or WhaleConfig.population
        return Whale(
            WhaleConfig(
                population=population,
                iterations=max(1, self.evaluations // population),
                evaluations=self.evaluations,
                stagnation=self.stagnation,
                per_dimension=self.per_dimension,
            )
        )


class TrainingSection(StrictSettings):
    """`[training]`."""

    compensator: bool = True
    hidden: int = Field(default=CompensatorConfig.hidden, ge=1, le=1000)
    window: int = Field(default=CompensatorConfig.window, ge=2, le=10**9)
    epochs: Count = AdamConfig.epochs
    patience: Count = AdamConfig.patience
    batch: Count = AdamConfig.batch
    learning_rate: float = Field(default=AdamConfig.learning_rate, gt=0, le=1)
    free_run: bool = True
    baselines: bool | None = None

    def training(self) -> CompensatorConfig | None:
        """Return the training of these settings, None for benchmarks alone."""
        if not self.compensator:
            return None
        adam = AdamConfig(self.epochs, self.patience, self.batch, self.learning_rate)
        free_run = SpeedCompensatorConfig() if self.free_run else None
        return CompensatorConfig(self.hidden, self.window, adam, free_run)


class RivalsSection(StrictSettings):
    """`[rivals]`."""

    quick: bool = True
    train: bool = False
    searches: bool = True


class IdentifyFile(StrictSettings):
    """The whole settings file."""

    seed: int = Field(default=0, ge=0, le=LARGEST_SEED)
    drift: bool | None = None
    lifting: ChannelSection = ChannelSection()
    lowering: ChannelSection = ChannelSection()
    choice: ChoiceSection = ChoiceSection()
    search: SearchSection = SearchSection()
    training: TrainingSection = TrainingSection()
    rivals: RivalsSection = RivalsSection()

    def rivals_config(self) -> RivalsConfig:
        """Return which rivals are fitted.

        `[training] baselines` and `[search] compare` are older keys for the same: true trains the rivals,
        false leaves out the quick ones, too, or the searches.
        """
        baselines, compare = self.training.baselines, self.search.compare
        trained = self.rivals.train or bool(baselines) or bool(compare)
        searches = self.rivals.searches if compare is None else compare
        quick = self.rivals.quick and baselines is not False
        return RivalsConfig(quick, trained, SearchComparison() if searches else None)

    def settings(self) -> Settings:
        """Return the arguments of `identify` that the file gives.

        Raises:
            InputError: there is no structure of a name, or bounds or budget do not fit.
        """
        sections: Mapping[str, ChannelSection] = {
            direction: getattr(self, direction) for direction in DIRECTIONS
        }
        specs = {direction: section.spec(direction) for direction, section in sections.items()}
        chosen = [direction for direction, spec in specs.items() if isinstance(spec, AutoStructure)]
        if self.choice.repeats and not chosen:
            raise InputError("choice, repeats: nothing is chosen, for both directions name a structure")
        specs |= {direction: replace(specs[direction], repeats=self.choice.repeats) for direction in chosen}
        return {
            "structure": specs,
            "search": self.search.search(),
            "training": self.training.training(),
            "dead_zones": {
                direction: s.dead_zone for direction, s in sections.items() if s.dead_zone is not None
            },
            "drift": self.drift,
            "rivals": self.rivals_config(),
            "seed": self.seed,
        }


def read_settings(path: Path) -> Settings:
    """Read the arguments of `identify` from a TOML file.

    Raises:
        SettingsError: the file cannot be read, is not TOML, or has a key or value that is not understood.
    """
    try:
        return parse_settings(path, IdentifyFile).settings()
    except SettingsError:
        raise
    except InputError as error:
        raise SettingsError(f"{path}: {error}") from error


def settings_of_model(described: Mapping[str, Any]) -> Settings:
    """Return the settings of an identification from what its model says of them; defaults where it is silent.

    Raises:
        SettingsError: they cannot be understood.
    """

    def by_key(section: type[StrictSettings], values: Mapping[str, Any]) -> dict[str, Any]:
        if values.get("automatic"):
            return {"load": values.get("load", ())}
        return {key: value for key, value in values.items() if key in section.model_fields}

    try:
        kept = KeptSettings.model_validate(described)
        content: dict[str, Any] = {
            direction: {**by_key(ChannelSection, values), "dead_zone": kept.dead_zones.get(direction)}
            for direction, values in kept.structure.items()
        }
        content["drift"] = kept.drift
        content["search"] = by_key(SearchSection, kept.search)
        content["training"] = by_key(TrainingSection, kept.training)
        return IdentifyFile.model_validate(content).settings()
    except ValidationError as error:
        raise SettingsError(f"the settings of the model: {describe_settings(error)}") from error
    except InputError as error:
        raise SettingsError(f"the settings of the model: {error}") from error


def stamp_of(settings: Settings) -> dict[str, object]:
    """Return all that the outcome of `identify_many` depends on beside the logs, as JSON values.

    Raises:
        InputError: an argument does not fit.
    """
    return IdentificationConfig.of(**settings).stamp
