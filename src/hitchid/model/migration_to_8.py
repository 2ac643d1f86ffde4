"""Migration of a model folder from schema 7 to schema 8."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

Description = dict[str, Any]
Tensors = dict[str, np.ndarray]
# Baselines of this package whose stored form schema 8 replaced.
_REPLACED = ("arx", "narx", "lstm")
_NO_COMPARISON = MappingProxyType({"baselines": (), "paper": None, "paper_parameters": None, "searches": ()})


def to_schema_8(content: Description, tensors: Tensors) -> tuple[Description, Tensors]:
    """Return a description and tensors in schema 8; what it replaced and cannot be computed is left out."""
    uncertainty = {
        direction: {**described, "bands": _bands(described["bands"])}
        for direction, described in content["uncertainty"].items()
    }
    comparison = {
        direction: _comparison(content["comparison"].get(direction, _NO_COMPARISON), described)
        for direction, described in content["channels"].items()
        if direction in content["comparison"] or described["speed_compensator"] is not None
    }
    channels = {direction: _channel(described) for direction, described in content["channels"].items()}
    migrated = {
        **content,
        "two_modes": _two_modes(content["two_modes"]),
        "uncertainty": uncertainty,
        "comparison": comparison,
        "channels": channels,
    }
    return migrated, tensors


def _two_modes(described: Description | None) -> Description | None:
    """Schema 8 tests two modes by the difference of the estimates.

    The ratio of mean square errors of earlier schemas has no F distribution: it and its p-value are left out.
    """
    if described is None:
        return None
    kept = ("needed", "shared_rmse", "two_rmse", "tests")
    return {**{name: described[name] for name in kept}, "difference": None}


def _bands(described: Description | None) -> Description | None:
    """Schema 8 lets the band of a prediction widen with the movement; older ones stay constant."""
    if described is None:
        return None
    ones = [1.0 for _ in described["horizons"]]
    spread = {"horizons": described["horizons"], "multipliers": described["half_widths"]}
    constant = {"noise": 0.0, "exponent": 0.0, "movements": ones, "growths": ones}
    kept = {key: value for key, value in described.items() if key not in ("horizons", "half_widths")}
    kept["ensemble"] = [member for member in described["ensemble"] if member["network"] is None]
    return {**kept, "predictions": {**spread, **constant}}


def _comparison(described: Mapping[str, Any], channel: Description) -> Description:
    """Schema 8 replaces the baselines of this package and adds the covariate that they use."""
    paper = described["paper"]
    dropped = [f"baseline {name}" for name in described["baselines"] if name in _REPLACED]
    if channel["speed_compensator"] is not None:
        dropped.append("network correction of the free run")
    return {
        **described,
        "baselines": [name for name in described["baselines"] if name not in _REPLACED],
        "covariate": None,
        "dropped": dropped,
        "paper": None if paper is None else _channel(paper),
    }


def _channel(described: Description) -> Description:
    """Schema 8 has another compensator for free run; the recurrent one of older schemas is left out."""
    return {**described, "speed_compensator": None}
