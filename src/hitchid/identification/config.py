"""Settings of an identification, one record each, and their description by the keys of the settings file."""

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType

import jax
from jaxtyping import Array, Key

from hitchid._support import checks
from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.jax_setup import installed_versions
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.estimation import DifferentialEvolution, MultiStart, Search, SearchComparison, Whale
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.selection import AutoStructure
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, LOWERING
from hitchid.structures import ModelSpec, registered_structures, structure_named

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
AUTOMATIC = "automatic"  # the name of the default choice of each direction
WHALE = Whale()
SEARCHES: Mapping[str, Search] = MappingProxyType(
    {search.name: search for search in (WHALE, DifferentialEvolution(), MultiStart())}
)
TRAINING = CompensatorConfig()
NO_DEAD_ZONES: Mapping[str, float] = MappingProxyType({})
LARGEST_SEED = 2**32 - 1  # upper limit of the seeds of NumPy's and JAX's generators
CAMPAIGN = 'a campaign as hitchid.read("logs") returns it'

Structures = ModelSpec | AutoStructure | str | Mapping[str, ModelSpec | AutoStructure | str]


@short_repr
@dataclass(frozen=True)
class RivalsConfig:
    """Which rivals are fitted beside a model.

    Attributes:
        quick: those that cost little: ARX and the paper's transfer function; persistence costs nothing.
        trained: also OE, NARX, the black-box LSTM, the paper's grey box, and baselines of other packages.
        searches: with `trained`, the global searches that are compared; None compares none.
    """

    quick: bool = True
    trained: bool = False
    searches: SearchComparison | None = field(default_factory=SearchComparison)

    @classmethod
    def of(cls, rivals: "RivalsConfig | bool | None") -> "RivalsConfig":
        """Return the setting of the argument `rivals` of `identify`.

        Raises:
            InputError: it is none of these.
        """
        if rivals is None:
            return cls(quick=False)
        if isinstance(rivals, bool):
            return cls(trained=rivals)
        return checks.instance(rivals, cls, "rivals", "True, False, None or RivalsConfig")


@dataclass(frozen=True)
class ChannelConfig:
    """Settings of the identification of one direction; see `identify`.

    `paper_spec` is fitted for comparison, `units` are those of displacement `x` and command `u`.
    """

    spec: ModelSpec | AutoStructure
    paper_spec: ModelSpec
    search: Search
    training: CompensatorConfig | None
    seed: int
    units: Mapping[str, str]
    quick_rivals: bool
    checkpoints: Checkpoints

    def random_keys(self, direction: str) -> Key[Array, "4"]:
        """Return the random keys of a direction: compensator, spare, baselines, the paper's method."""
        direction_key = jax.random.fold_in(jax.random.key(self.seed), DIRECTIONS.index(direction))
        return jax.random.split(direction_key, 4)

    @property
    def search_spec(self) -> ModelSpec:
        """The structure that searches are compared on: the given one, or the first of an automatic choice."""
        return self.spec.baseline_spec if isinstance(self.spec, AutoStructure) else self.spec


@dataclass(frozen=True)
class IdentificationConfig:
    """Settings of an identification; see `identify`.

    Attributes:
        specs: direction to the model specification of its benchmark, or its automatic choice.
        search, training, dead_zones, drift, rivals, seed: see `identify`.
    """

    specs: Mapping[str, ModelSpec | AutoStructure]
    search: Search
    training: CompensatorConfig | None
    dead_zones: Mapping[str, float]
    drift: bool | None
    rivals: RivalsConfig
    seed: int

    @classmethod
    def of(
        cls,
        structure: Structures = DEFAULT_STRUCTURES,
        search: Search | str = WHALE,
        training: CompensatorConfig | None = TRAINING,
        dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
        drift: bool | None = None,
        rivals: RivalsConfig | bool | None = False,
        seed: int = 0,
    ) -> "IdentificationConfig":
        """Return the settings that the arguments of `identify` give.

        Raises:
            InputError: an argument has the wrong type, or a value outside its limits.
        """
        if isinstance(search, str):
            search = SEARCHES[checks.one_of(search, SEARCHES, "search")]
        checks.instance(
            search, Search, "search", f"one of {', '.join(SEARCHES)}, or a Search of hitchid.estimation"
        )
        checks.instance(training, (CompensatorConfig, type(None)), "training", "CompensatorConfig or None")
        if drift is not None:
            checks.instance(drift, bool, "drift", "True, False or None")
        if checks.integer(seed, "seed") > LARGEST_SEED:
            raise checks.input_error("seed", f"at most {LARGEST_SEED}", seed)
        for direction, dead_zone in checks.mapping_of(dead_zones, DIRECTIONS, "dead_zones").items():
            if checks.number(dead_zone, f"dead_zones, {direction}") < 0:
                raise InputError(f"dead_zones, {direction}: expected at least 0, got {dead_zone}")
        if isinstance(structure, str | ModelSpec | AutoStructure):
            structure = dict.fromkeys(DIRECTIONS, structure)
        structures = checks.mapping_of(structure, DIRECTIONS, "structure")
        specs = {
            direction: _spec_of(structures.get(direction, AUTOMATIC), direction) for direction in DIRECTIONS
        }
        return cls(specs, search, training, dead_zones, drift, RivalsConfig.of(rivals), seed)

    def with_campaign_covariates(self, campaign: Campaign) -> "IdentificationConfig":
        """Return the settings with the campaign's covariates where an automatic choice names none."""
        specs = dict(self.specs)
        for direction, spec in self.specs.items():
            if isinstance(spec, AutoStructure) and not spec.covariate_names:
                specs[direction] = replace(spec, covariate_names=campaign.covariates)
        return replace(self, specs=specs)

    def channel(self, direction: str, campaign: Campaign, checkpoints: Checkpoints) -> ChannelConfig:
        """Return the settings of one direction of a campaign."""
        return ChannelConfig(
            spec=self.specs[direction],
            paper_spec=PAPER_SPECS[direction],
            search=self.search,
            training=self.training,
            seed=self.seed,
            units={"x": campaign.units[DISPLACEMENT], "u": campaign.units[COMMAND[direction]]},
            quick_rivals=self.rivals.quick,
            checkpoints=checkpoints.child(direction),
        )

    def describe(self) -> dict[str, object]:
        """Return the settings as JSON values, by the keys of the settings file as far as it has them."""
        search = _flat(asdict(self.search)) if is_dataclass(self.search) else {}
        training: dict[str, object] = {"compensator": False}
        if self.training is not None:
            free_run = self.training.free_run
            training = {
                "compensator": True,
                "hidden": self.training.hidden,
                "window": self.training.window,
                **asdict(self.training.adam),
                "free_run": free_run is not None,
                **({f"free_run_{key}": value for key, value in asdict(free_run).items()} if free_run else {}),
            }
        return {
            "structure": {direction: _describe_spec(spec) for direction, spec in self.specs.items()},
            "search": {
                "method": self.search.name,
                **{key: value for key, value in search.items() if key != "name"},
            },
            "training": training,
            "dead_zones": dict(self.dead_zones),
            "drift": self.drift,
        }

    @property
    def stamp(self) -> dict[str, object]:
        """All that the outcome depends on beside the logs, as JSON values."""
        # Where a comparison keeps its runs changes nothing in them.
        searches = self.rivals.searches and replace(self.rivals.searches, checkpoints=DISABLED)
        return {
            "asked": {**self.describe(), "forms": repr(self.specs), "seed": self.seed},
            "search": repr(self.search),
            "training": repr(self.training),
            "rivals": repr(replace(self.rivals, searches=searches)),
            "machine": f"{platform.machine()} {jax.default_backend()}",
            "versions": installed_versions(),
        }

    def checkpoints(self, folder: Path | None, campaign: Campaign) -> Checkpoints:
        """Return the checkpoints of runs with the same logs, settings, versions and kind of machine."""
        if folder is None:
            return DISABLED
        return Checkpoints.of_run(folder, {**self.stamp, "campaign": campaign.digest})


def check_campaign(value: object) -> Campaign:
    """Return a campaign; raises InputError for anything else, such as the folder to read it from."""
    return checks.instance(value, Campaign, "campaign", CAMPAIGN)


def _spec_of(value: object, direction: str) -> ModelSpec | AutoStructure:
    if value == AUTOMATIC:
        return DEFAULT_STRUCTURES[direction]
    if isinstance(value, str):
        return ModelSpec(structure_named(value))
    names = ", ".join((AUTOMATIC, *registered_structures()))
    required = f"one of {names}, or a ModelSpec or AutoStructure"
    return checks.instance(value, (ModelSpec, AutoStructure), f"structure, {direction}", required)


def _describe_spec(spec: ModelSpec | AutoStructure) -> dict[str, object]:
    if isinstance(spec, AutoStructure):
        return {"automatic": True, "load": list(spec.covariate_names), "repeats": spec.repeats}
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
        "without": list(spec.without),
        "bounds": {name: list(limits) for name, limits in spec.bounds.items()},
    }


def _flat(values: Mapping[str, object]) -> dict[str, object]:
    """Return a mapping with the entries of nested mappings in their place."""
    flat = {}
    for key, value in values.items():
        flat |= _flat(value) if isinstance(value, Mapping) else {key: value}
    return flat
