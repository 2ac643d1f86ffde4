"""Limits that a validation is held against, from a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from hitchid._support.metrics import HORIZONS
from hitchid.data.record import MODES
from hitchid.data.signal_map import Strict, parse_settings
from hitchid.data.units import UNITS, conversion_factor
from hitchid.errors import SettingsError
from hitchid.validation.tables import NAMES

CYCLES = "cycles"
BASELINES = tuple(name for name in NAMES if name != "greybox")

# TOML knows numbers from text: strict keeps rmse = "0.5" from being read as a number.
Most = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
Percent = Annotated[float, Field(strict=True, gt=0, le=100, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)]


class _Demanding(Strict):
    """Limits of which at least one is given: what demands nothing accepts everything."""

    @model_validator(mode="after")
    def _demands(self) -> "_Demanding":
        limits = {name: value for name, value in self if name != "unit"}
        if all(value is None for value in limits.values()):
            raise ValueError(f"demands nothing; required at least one of {', '.join(limits)}")
        return self


class FigureLimits(_Demanding):
    """Limits of the figures of one run.

    Attributes:
        rmse, mae, max_abs: at most, in the unit of the limits.
        r2: at least, a fraction.
        fit: at least, percent.
        within_1: percent of samples whose error is below one unit of the logs; at least.
    """

    rmse: Most | None = None
    mae: Most | None = None
    max_abs: Most | None = None
    r2: Share | None = None
    fit: Percent | None = None
    within_1: Percent | None = None


class ModeLimits(_Demanding):
    """Limits of one direction or of the cycles.

    Attributes:
        tests: number of unseen tests; at least.
        free_run, one_step: of all unseen tests together.
        worst_test: of every single test in free run.
        horizon: RMSE by samples ahead; at most, in the unit of the limits.
        coverage: percent of unseen samples inside the band in free run; at least and at most.
        better_than: baselines whose RMSE the grey box must stay below, in each run that both have.
    """

    tests: Annotated[int, Field(strict=True, ge=1)] | None = None
    free_run: FigureLimits | None = None
    one_step: FigureLimits | None = None
    worst_test: FigureLimits | None = None
    horizon: dict[int, Most] | None = None
    coverage: tuple[Percent, Percent] | None = None
    better_than: tuple[str, ...] | None = None

    @field_validator("horizon", mode="before")
    @classmethod
    def _validated_horizons(cls, given: object) -> object:
        if not isinstance(given, Mapping):
            return given
        known = {str(steps): steps for steps in HORIZONS}
        if not given:
            raise ValueError(f"demands nothing; required one of {', '.join(known)} samples ahead")
        for key in given:
            if str(key) not in known:
                raise ValueError(f"came '{key}' samples ahead, required one of {', '.join(known)}")
        return {known[str(key)]: limit for key, limit in given.items()}

    @field_validator("coverage")
    @classmethod
    def _ordered(cls, given: tuple[float, float] | None) -> tuple[float, float] | None:
        if given is not None and given[0] > given[1]:
            raise ValueError(f"came {list(given)}, required [at least, at most]")
        return given

    @field_validator("better_than")
    @classmethod
    def _baselines(cls, given: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if given == ():
            raise ValueError(f"demands nothing; required one of {', '.join(BASELINES)}")
        for name in given or ():
            if name not in BASELINES:
                raise ValueError(f"came '{name}', required one of {', '.join(BASELINES)}")
        if given is not None and len(set(given)) < len(given):
            raise ValueError(f"came {', '.join(given)}, required each once")
        return given


class Limits(_Demanding):
    """All of a limits file.

    Attributes:
        unit: of every error limit.
        lifting, lowering, cycles: what is demanded of each.
    """

    unit: str
    lifting: ModeLimits | None = None
    lowering: ModeLimits | None = None
    cycles: ModeLimits | None = None

    @field_validator("unit")
    @classmethod
    def _known(cls, unit: str) -> str:
        if unit not in UNITS:
            raise ValueError(f"required one of {', '.join(UNITS)}")
        return unit

    @property
    def modes(self) -> dict[str, ModeLimits]:
        """Return what is demanded, by direction or `cycles`."""
        each = {mode: getattr(self, mode) for mode in (*MODES, CYCLES)}
        return {mode: limits for mode, limits in each.items() if limits is not None}

    def check_convertible(self, unit: str) -> None:
        """Complain about limits that errors in the logs' unit cannot be held against.

        Args:
            unit: of the logs' displacement.

        Raises:
            SettingsError: the dimensions differ, or `within_1` is limited and the units differ.
        """
        conversion_factor(self.unit, unit, "limits: key 'unit'")
        for mode, limits in self.modes.items():
            for run in ("one_step", "free_run", "worst_test"):
                figures: FigureLimits | None = getattr(limits, run)
                if figures is not None and figures.within_1 is not None and self.unit != unit:
                    raise SettingsError(
                        f"limits: key '{mode}.{run}.within_1': counts errors below 1 {unit}, the logs' unit, "
                        f"and cannot be converted to '{self.unit}'; required unit = \"{unit}\""
                    )


def read_limits(path: str | Path) -> Limits:
    """Read acceptance limits from a TOML file.

    Raises:
        SettingsError: the file cannot be read, is not TOML, has a key or value that is not understood, or
            demands nothing.
    """
    return parse_settings(Path(path), Limits)
