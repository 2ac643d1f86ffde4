"""Where a model comes from, and the test of its two modes."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from: enough to repeat it, and to list the tests it was identified from.

    Attributes:
        identification, validation, held_out: direction to the names of the tests that the benchmark was
            identified from, of those among them that stopped the training, and of those not used.
        seen: fingerprints of every record the identification used.
        segmentation_dead_zones: direction to the dead zone with which mixed cycles were cut into strokes;
            empty where none were.
        seed: the seed of every random draw.
        settings: of the identification, as JSON can hold them.
        versions: package to version.
        digest: of the folder it was read from; empty before it is saved.
    """

    identification: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    validation: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    held_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seen: frozenset[str] = frozenset()
    segmentation_dead_zones: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    settings: Mapping[str, object] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    digest: str = field(default="", compare=False)


@dataclass(frozen=True)
class TwoModes:
    """Whether the plant needs two modes: one shared linear model against one for each direction.

    Attributes:
        needed: whether held-out tests prove two models better and the statistic is significant at 1 %.
        shared_rmse, two_rmse: free run on tests held out in turn, each weighing the same, in the
            displacement's unit.
        f_statistic: of nested models, over the identification tests.
        p_value: chance of one as large, if one model were enough.
        tests: how many there were.
    """

    needed: bool
    shared_rmse: float
    two_rmse: float
    f_statistic: float
    p_value: float
    tests: int

    @property
    def sentence(self) -> str:
        """The finding in words."""
        verdict = "the plant needs two modes" if self.needed else "one mode would do"
        return (
            f"{verdict}: free run on tests held out in turn {self.shared_rmse:.4g} with one shared model, "
            f"{self.two_rmse:.4g} with two; F = {self.f_statistic:.3g}, p = {self.p_value:.2g}, "
            f"{self.tests} tests"
        )
