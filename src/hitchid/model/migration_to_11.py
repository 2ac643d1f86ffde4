"""Migration of a model folder from schema 10 to schema 11."""

from typing import Any

import numpy as np

from hitchid.structures import registered_structures, scheduled_quantities

Description = dict[str, Any]
Tensors = dict[str, np.ndarray]
CURVES = 7  # parameters of the nonlinearities that are left; shift of the opening and gain by load followed
# Of one number in schema 10, of a number for each covariate in schema 11.
_BY_COVARIATE = ("/load/lowest", "/load/highest", "/load_centre", "/load_scale")


def to_schema_11(content: Description, tensors: Tensors) -> tuple[Description, Tensors]:
    """Return a description and tensors in schema 11, which has any number of covariates.

    Raises:
        ValueError: a structure is not known.
    """
    channels = content["channels"]
    uncertainty = {
        direction: _uncertainty(described, channels[direction])
        for direction, described in content["uncertainty"].items()
    }
    migrated = {
        **content,
        "channels": {direction: _channel(channel) for direction, channel in channels.items()},
        "comparison": {name: _comparison(described) for name, described in content["comparison"].items()},
        "uncertainty": uncertainty,
        "set_by_hand": {
            direction: {
                _parameter_name(name, channels[direction]["load"]): value for name, value in values.items()
            }
            for direction, values in content["set_by_hand"].items()
        },
    }
    arrays = {
        name: array.reshape(1) if name.endswith(_BY_COVARIATE) and not array.ndim else array
        for name, array in tensors.items()
    }
    return migrated, arrays


def _channel(described: Description) -> Description:
    shape, load = described["shape"], described["load"]
    kept = {key: value for key, value in described.items() if key != "load"}
    if shape is None:
        return {**kept, "scheduling": None}
    scales = shape["scales"]
    curves = {
        "values": shape["values"][:CURVES],
        "scales": {name: scales[name] for name in ("command", "centre", "span")},
    }
    if load is None:
        return {**kept, "shape": curves, "scheduling": None}
    scheduling = {
        "covariates": [load],
        "quantities": list(_quantities(described)),
        "centre": [scales["load_centre"]],
        "spread": [scales["load_spread"]],
        "effects": [[row] for row in _effects(described, shape["values"][CURVES:]).tolist()],
    }
    return {**kept, "shape": curves, "scheduling": scheduling}


def _quantities(channel: Description) -> tuple[str, ...]:
    structure = registered_structures().get(channel["structure"])
    if structure is None:
        raise ValueError(f"the structure '{channel['structure']}' is not known")
    return scheduled_quantities(structure.require_linear())


def _effects(channel: Description, shift_and_gain: list[float]) -> np.ndarray:
    """Return the effects of the covariate and of its square, shape [P, 2]; gain first, opening last."""
    effects = np.zeros((len(_quantities(channel)), 2))
    effects[-1, 0], effects[0, 0] = shift_and_gain
    return effects


def _comparison(described: Description) -> Description:
    kept = {key: value for key, value in described.items() if key != "covariate"}
    covariate, paper = described["covariate"], described["paper"]
    covariates = [] if covariate is None else [covariate]
    return {**kept, "covariates": covariates, "paper": None if paper is None else _channel(paper)}


def _uncertainty(described: Description, channel: Description) -> Description:
    load, bands, information = channel["load"], described["bands"], described["information"]
    migrated = {**described, "benchmark": _estimates(described["benchmark"], load)}
    if bands is not None:
        ensemble = [
            {**member, "benchmark": _parameter_vector(member["benchmark"], channel)}
            for member in bands["ensemble"]
        ]
        migrated["bands"] = {**bands, "ensemble": ensemble}
    if information is not None:
        names = [_parameter_name(name, load) for name in information["names"]]
        migrated["information"] = {**information, "names": names}
    return migrated


def _estimates(described: Description, load: str | None) -> Description:
    parameters = [
        {**parameter, "name": _parameter_name(parameter["name"], load)}
        for parameter in described["parameters"]
    ]
    return {**described, "parameters": parameters}


def _parameter_name(name: str, load: str | None) -> str:
    renamed = {"load_gain": f"gain_by_{load}", "load_shift": f"opening_by_{load}"}
    return renamed.get(name, name)


def _parameter_vector(row: list[float], channel: Description) -> list[float]:
    """Return a row of structure's values, dead time and curves with the effects of covariates last."""
    if channel["shape"] is None:
        return row
    last = len(channel["values"]) + 1 + CURVES
    if channel["load"] is None:
        return row[:last]
    return [*row[:last], *_effects(channel, row[last:]).ravel().tolist()]
