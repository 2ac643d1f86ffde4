"""Acceptance limits of a validation, from a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from hitchid._support.metrics import HORIZONS
from hitchid.errors import InputError, SettingsError
from hitchid.logs.record import DIRECTIONS
from hitchid.logs.signal_map import StrictSettings, parse_settings
from hitchid.logs.units import UNITS, conversion_factor
from hitchid.validation.results import CYCLES, GREYBOX, NAMES, ONE_STEP

BASELINES = tuple(name for name in NAMES if name != GREYBOX)

# Strict: text such as rmse = "0.5" is refused rather than read as a number.
PositiveError = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
Percent = Annotated[float, Field(strict=True, gt=0, le=100, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)]


class _NonEmptyLimits(StrictSettings):
    """Limits, at least one of which is required: a file without limits would accept every model."""

    @model_validator(mode="after")
    def _require_any(self) -> "_NonEmptyLimits":
        limits = {name: value for name, value in self if name != "unit"}
        if all(value is None for value in limits.values()):
            raise ValueError(f"is empty; expected at least one of {', '.join(limits)}")
        return self


class FigureLimits(_NonEmptyLimits):
    """Limits of the figures of one run.

    Attributes:
        rmse, mae, max_abs: at most, in the unit of the limits.
        r2: at least, a fraction.
        fit: at least, percent.
        within_1: percent of samples with an error below one unit of the logs; at least.
    """

    rmse: PositiveError | None = None
    mae: PositiveError | None = None
    max_abs: PositiveError | None = None
    r2: Share | None = None
    fit: Percent | None = None
    within_1: Percent | None = None


class DirectionLimits(_NonEmptyLimits):
    """Limits of one direction or of the cycles.

    Attributes:
        tests: number of unseen tests; at least.
        free_run, one_step: of all unseen tests together.
        worst_test: of every single test in free run.
        horizon: RMSE by samples ahead; at most, in the unit of the limits.
        coverage: percent of unseen samples inside the band in free run; at least and at most.
        better_than: baselines with an upper limit on the grey box: their own RMSE, in each run of both.
    """

    tests: Annotated[int, Field(strict=True, ge=1)] | None = None
    free_run: FigureLimits | None = None
    one_step: FigureLimits | None = None
    worst_test: FigureLimits | None = None
    horizon: dict[int, PositiveError] | None = None
    coverage: tuple[Percent, Percent] | None = None
    better_than: tuple[str, ...] | None = None

    def run(self, name: str) -> FigureLimits | None:
        """Return the limits of `one_step` or `free_run`."""
        return self.one_step if name == ONE_STEP else self.free_run

    @field_validator("horizon", mode="before")
    @classmethod
    def _validated_horizons(cls, value: object) -> object:
        if not isinstance(value, Mapping):
            return value
        horizons = {str(steps): steps for steps in HORIZONS}
        if not value:
            raise ValueError(f"is empty; expected one of {', '.join(horizons)} samples ahead")
        for key in value:
            if str(key) not in horizons:
                raise ValueError(f"got '{key}' samples ahead, expected one of {', '.join(horizons)}")
        return {horizons[str(key)]: limit for key, limit in value.items()}

    @field_validator("coverage")
    @classmethod
    def _require_ordered(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] > value[1]:
            raise ValueError(f"got {list(value)}, expected [at least, at most]")
        return value

    @field_validator("better_than")
    @classmethod
    def _require_known_baselines(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value == ():
            raise ValueError(f"is empty; expected one of {', '.join(BASELINES)}")
        for name in value or ():
            if name not in BASELINES:
                raise ValueError(f"got '{name}', expected one of {', '.join(BASELINES)}")
        if value is not None and len(set(value)) < len(value):
            raise ValueError(f"got {', '.join(value)}, expected each once")
        return value


class AcceptanceLimits(_NonEmptyLimits):
    """Content of a limits file.

    Attributes:
        unit: of every error limit.
        lifting, lowering, cycles: limits of each.
    """

    unit: str
    lifting: DirectionLimits | None = None
    lowering: DirectionLimits | None = None
    cycles: DirectionLimits | None = None

    @field_validator("unit")
    @classmethod
    def _require_known_unit(cls, unit: str) -> str:
        if unit not in UNITS:
            raise ValueError(f"expected one of {', '.join(UNITS)}")
        return unit

    @property
    def by_direction(self) -> dict[str, DirectionLimits]:
        """Return the limits by direction or `cycles`."""
        all_limits = {direction: getattr(self, direction) for direction in (*DIRECTIONS, CYCLES)}
        return {direction: limits for direction, limits in all_limits.items() if limits is not None}

    def check_convertible(self, unit: str) -> None:
        """Raise where errors in the logs' unit cannot be compared with the limits.

        Args:
            unit: of the logs' displacement.

        Raises:
            SettingsError: the dimensions differ, or `within_1` is limited and the units differ.
        """
        try:
            conversion_factor(self.unit, unit, "limits: key 'unit'")
        except InputError as error:
            raise SettingsError(str(error)) from error
        for direction, limits in self.by_direction.items():
            runs = {"one_step": limits.one_step, "free_run": limits.free_run, "worst_test": limits.worst_test}
            for run, figures in runs.items():
                if figures is not None and figures.within_1 is not None and self.unit != unit:
                    raise SettingsError(
                        f"limits: key '{direction}.{run}.within_1': counts errors below 1 {unit}, the logs' "
                        f"unit, and cannot be converted to '{self.unit}'; required unit = \"{unit}\""
                    )


def read_limits(path: str | Path) -> AcceptanceLimits:
    """Read acceptance limits from a TOML file.

    Raises:
        SettingsError: the file cannot be read, is not TOML, has a key or value that is not understood, or
            has no limit.
    """
    return parse_settings(Path(path), AcceptanceLimits)
