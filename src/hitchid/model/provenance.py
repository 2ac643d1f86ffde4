"""Provenance of a model, and the test of its two modes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from hitchid._support.records import short_repr

CLEAR_RATIO = 1.25  # of the errors of one shared model and of two, from which on two are better; chosen


@short_repr
@dataclass(frozen=True)
class Provenance:
    """Provenance of a model: tests, settings, seed and versions, sufficient to repeat the identification.

    Attributes:
        identification, validation, held_out: direction to names of tests: those the benchmark was identified
            from, those of them for early stopping of the training, and those not used.
        seen: fingerprints of all records used in the identification.
        segmentation_dead_zones: direction to the dead zone with which mixed cycles were cut into strokes;
            empty where none were.
        seed: seed of all random draws.
        settings: settings of the identification as content for JSON.
        versions: package to version.
        set_by_hand: direction to name and value of the parameters that were set by hand since.
        adapted: direction to name and value of the changes that adaptation made since.
        digest: digest of the folder the model was read from; empty before it is saved.
        name: name of that folder; empty before it is saved.
        date: day on which its `model.json` was last written, UTC, as `2025-03-31`; empty before it is saved.
    """

    identification: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    validation: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    held_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seen: frozenset[str] = frozenset()
    segmentation_dead_zones: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    settings: Mapping[str, object] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    set_by_hand: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    adapted: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    digest: str = field(default="", compare=False)
    name: str = field(default="", compare=False)
    date: str = field(default="", compare=False)


@dataclass(frozen=True)
class DifferenceTest:
    """Hotelling's test that two directions have the same parameters.

    Attributes:
        statistic: (ν − p + 1)/(ν p) dᵀ C⁻¹ d, d being the differences of the estimates, C their covariance.
        parameters: names of the p parameters compared.
        degrees_of_freedom: ν − p + 1, of the denominator of F.
        p_value: probability of a statistic as large if the directions have the same parameters.
    """

    statistic: float
    parameters: tuple[str, ...]
    degrees_of_freedom: float
    p_value: float

    @property
    def sentence(self) -> str:
        """Sentence that states the result."""
        names = ", ".join(name.replace("_", " ") for name in self.parameters)
        return (
            f"Hotelling's test of {names}: F({len(self.parameters)}, {self.degrees_of_freedom:.3g}) = "
            f"{self.statistic:.3g}, p = {self.p_value:.2g}"
        )


@short_repr
@dataclass(frozen=True)
class TwoModes:
    """Test for two modes: one shared linear model compared with one for each direction.

    Attributes:
        needed: whether the parameters of the two directions differ significantly at 5 %.
        shared_rmse, two_rmse: free-run RMSE of one and of two models in cross-validation, all tests with
            equal weight, in the displacement's unit.
        tests: number of tests.
        difference: test of the difference; None where the tests are too few for it.
    """

    needed: bool
    shared_rmse: float
    two_rmse: float
    tests: int
    difference: DifferenceTest | None = None

    @property
    def sentence(self) -> str:
        """Sentence that states the result."""
        if self.needed:
            verdict = "the two directions differ significantly"
        elif self.shared_rmse > CLEAR_RATIO * self.two_rmse:
            # Few tests: the error tells the directions apart before a test of their parameters can.
            verdict = (
                f"two models err {self.shared_rmse / self.two_rmse:.3g} times less than one, though the "
                "parameters of the two directions do not differ significantly over so few tests"
            )
        else:
            verdict = "the two directions do not differ significantly"
        tested = "not tested for significance" if self.difference is None else self.difference.sentence
        return (
            f"{verdict}: free-run RMSE in cross-validation {self.shared_rmse:.4g} with one shared model, "
            f"{self.two_rmse:.4g} with two, {self.tests} tests; {tested}"
        )
