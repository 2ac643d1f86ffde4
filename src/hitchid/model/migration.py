"""Migration of model folders from earlier schemas to the present one."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from hitchid.model.load_filter import LoadFilter
from hitchid.model.migration_to_8 import to_schema_8
from hitchid.model.migration_to_11 import to_schema_11
from hitchid.model.tensors import tensors_of

Description = dict[str, Any]
Tensors = dict[str, np.ndarray]
Stored = tuple[Description, Tensors]
DRIFT_IN_TIME = 6  # index, in schema 9, among the values of an inertia with friction
SCHEMA_11_HORIZON = 100  # samples that every compensator of schema 11 corrected after a measurement
SCHEMA = 12  # version of the layout of a model folder


def _with_hold(content: Description, tensors: Tensors) -> Stored:
    """Schema 4 adds the drift of a held piston, and the test of two modes."""
    return {**content, "drift": 0.0, "two_modes": None}, tensors


def _with_uncertainty(content: Description, tensors: Tensors) -> Stored:
    """Schema 5 adds the uncertainty of each channel."""
    return {**content, "uncertainty": {}}, tensors


def _with_comparison(content: Description, tensors: Tensors) -> Stored:
    """Schema 6 separates the models for comparison and adds an operating range to each channel."""
    channels = content["channels"]
    comparison = {
        direction: _comparison(channel, content["uncertainty"].get(direction, {}))
        for direction, channel in channels.items()
    }
    migrated = {
        **content,
        "channels": {direction: _channel(channel) for direction, channel in channels.items()},
        "comparison": {direction: parts for direction, parts in comparison.items() if any(parts.values())},
        "uncertainty": {
            direction: _uncertainty(uncertainty) for direction, uncertainty in content["uncertainty"].items()
        },
    }
    renamed = {_tensor_name(name): array for name, array in tensors.items()}
    papers = [f"{direction}/paper" for direction, channel in channels.items() if "paper" in channel]
    unbounded = {
        f"{owner}/operating_range/{signal}/{end}": np.array(value)
        for owner in (*channels, *papers)
        for signal in ("command", "displacement", "load")
        for end, value in (("lowest", -np.inf), ("highest", np.inf))
    }
    return migrated, {**unbounded, **renamed}


def _with_set_by_hand(content: Description, tensors: Tensors) -> Stored:
    """Schema 7 adds the parameters that were set by hand."""
    return {**content, "set_by_hand": {}}, tensors


def _with_load_filter(content: Description, tensors: Tensors) -> Stored:
    """Schema 9 adds a load filter to each channel; without one the last measured error stays."""
    papers = [f"{name}/paper" for name, known in content["comparison"].items() if known["paper"] is not None]
    none = tensors_of(LoadFilter.none(), "load_filter")
    added = {
        f"{owner}/{name}": array for owner in (*content["channels"], *papers) for name, array in none.items()
    }
    return content, {**tensors, **added}


def _without_clock(content: Description, tensors: Tensors) -> Stored:
    """Schema 10: the offset of an inertia with friction drifts with the distance travelled, not with time."""
    for direction, channel in content["channels"].items():
        if channel["structure"] == "inertia-with-friction" and channel["values"][DRIFT_IN_TIME]:
            raise ValueError(
                f"{direction}: the offset of 'inertia-with-friction' drifts with time, expected with the "
                "distance travelled; identify again"
            )
    return content, tensors


def _with_max_horizon(content: Description, tensors: Tensors) -> Stored:
    """Schema 12 adds the largest horizon of each compensator for predictions."""

    def channel(described: Description) -> Description:
        compensator = described["compensator"]
        if compensator is not None:
            compensator = {**compensator, "max_horizon": SCHEMA_11_HORIZON}
        return {**described, "compensator": compensator}

    def models(known: Description) -> Description:
        paper = known["paper"]
        return {**known, "paper": None if paper is None else channel(paper)}

    migrated = {
        **content,
        "channels": {name: channel(described) for name, described in content["channels"].items()},
        "comparison": {name: models(known) for name, known in content["comparison"].items()},
    }
    return migrated, tensors


# Part of a tensor's name in schema 5 to that in schema 6.
_TENSOR_NAMES = {
    "/arx/": "/baselines/arx/",
    "/narx/": "/baselines/narx/",
    "/black_box/": "/baselines/lstm/",
    "/envelope/": "/operating_range/",
    "/speed_compensator/command": "/speed_compensator/command_scale",
    "/speed_compensator/moved": "/speed_compensator/increment_scale",
}
_FITTED = {"arx": "arx", "narx": "narx", "black_box": "lstm"}


def _tensor_name(name: str) -> str:
    for old, new in _TENSOR_NAMES.items():
        name = name.replace(old, new)
    return name


def _channel(described: Description) -> Description:
    description = {
        key: value for key, value in described.items() if key not in (*_FITTED, "paper", "envelope")
    }
    speed = described.get("speed_compensator")
    if speed is not None:
        speed = _renamed(speed, every="block_size")
    return {"limits": None, **description, "speed_compensator": speed}


def _comparison(channel: Description, uncertainty: Description) -> Description:
    paper = channel.get("paper")
    return {
        "baselines": [name for key, name in _FITTED.items() if key in channel],
        "paper": None if paper is None else _channel(paper),
        "paper_parameters": uncertainty.get("paper"),
        "searches": [_search_summary(search) for search in uncertainty.get("searches", ())],
    }


def _uncertainty(described: Description) -> Description:
    bands, information = described["bands"], described["information"]
    if bands is not None:
        bands = _renamed(bands, alternatives="ensemble", ahead="half_widths")
        bands["ensemble"] = [_renamed(member, member="network") for member in bands["ensemble"]]
    if information is not None:
        information = _renamed(
            information,
            scatter="score_covariance",
            fixed="dead_zone_covariance",
            every="block_size",
            apart="per_test_gain",
        )
    return {
        "benchmark": described["benchmark"],
        "bands": bands,
        "information": information,
        "characteristics": described.get("characteristics"),
    }


def _search_summary(search: Description) -> Description:
    runs = search["runs"]
    rmse = [run["fitness"][-1] if run["fitness"] else None for run in runs]
    order = np.argsort([np.inf if error is None else error for error in rmse])
    median = runs[int(order[len(runs) // 2])]
    return {
        "name": search["name"],
        "rmse": rmse,
        "evaluations": [run["evaluations"] for run in runs],
        "failures": [run["failures"] for run in runs],
        "median_rmse": median["fitness"],
        "median_values": median["values"],
    }


def _renamed(described: Description, **names: str) -> Description:
    return {names.get(key, key): value for key, value in described.items()}


MIGRATIONS: Mapping[int, Callable[[Description, Tensors], Stored]] = MappingProxyType(
    {
        3: _with_hold,
        4: _with_uncertainty,
        5: _with_comparison,
        6: _with_set_by_hand,
        7: to_schema_8,
        8: _with_load_filter,
        9: _without_clock,
        10: to_schema_11,
        11: _with_max_horizon,
    }
)
"""Schema to the migration to the next one; content that an older schema lacks is marked as missing."""


def is_readable(schema: object) -> bool:
    """Return whether a description has the present schema or can be migrated to it."""
    return type(schema) is int and (schema == SCHEMA or schema in MIGRATIONS)


def migrate(content: Description, tensors: Tensors) -> Stored:
    """Return a description and tensors in the present schema, migrated one schema at a time."""
    while content["schema"] in MIGRATIONS:
        schema = content["schema"]
        content, tensors = MIGRATIONS[schema](content, tensors)
        content = {**content, "schema": schema + 1}
    return content, tensors
