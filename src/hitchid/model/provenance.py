"""Provenance of a model, and the test of its two modes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from hitchid._support.short_repr import short_repr


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
    digest: str = field(default="", compare=False)
    name: str = field(default="", compare=False)
    date: str = field(default="", compare=False)


@short_repr
@dataclass(frozen=True)
class TwoModes:
    """Test for two modes: one shared linear model compared with one for each direction.

    Attributes:
        needed: whether two models are better on held-out tests and the statistic is significant at 1 %.
        shared_rmse, two_rmse: free-run RMSE of one and of two models in cross-validation, all tests with
            equal weight, in the displacement's unit.
        f_statistic: F statistic of the nested models, over the identification tests.
        p_value: probability of a statistic as large if one model is sufficient.
        tests: number of tests.
    """

    needed: bool
    shared_rmse: float
    two_rmse: float
    f_statistic: float
    p_value: float
    tests: int

    @property
    def sentence(self) -> str:
        """Sentence that states the result."""
        verdict = "two separate models are justified" if self.needed else "one shared model is sufficient"
        return (
            f"{verdict}: free-run RMSE in cross-validation {self.shared_rmse:.4g} with one shared model, "
            f"{self.two_rmse:.4g} with two; F = {self.f_statistic:.3g}, p = {self.p_value:.2g}, "
            f"{self.tests} tests"
        )
