"""Conversion between a model and JSON and tensors."""

from dataclasses import asdict
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from hitchid.model.channel_description import channel_tensors, describe_channel, read_channel
from hitchid.model.hitch import Hitch
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.model.tensors import Tensors
from hitchid.model.uncertainty import Uncertainty

KIND = "hitchid model"
SCHEMA = 13  # version of the layout of a model folder
SUBSETS = ("identification", "validation", "held_out")
_UNCERTAINTY = TypeAdapter(Uncertainty)
_TWO_MODES = TypeAdapter(TwoModes | None)


def describe(hitch: Hitch) -> dict[str, object]:
    """Return the model without its trained arrays as content for JSON."""
    provenance = hitch.provenance
    return {
        "schema": SCHEMA,
        "kind": KIND,
        "step_s": hitch.step_s,
        "units": dict(hitch.units),
        "drift": hitch.drift,
        "two_modes": None if hitch.two_modes is None else asdict(hitch.two_modes),
        "uncertainty": {
            direction: asdict(uncertainty) for direction, uncertainty in hitch.uncertainty.items()
        },
        "channels": {direction: describe_channel(channel) for direction, channel in hitch.channels.items()},
        "split": {
            subset: {direction: list(names) for direction, names in getattr(provenance, subset).items()}
            for subset in SUBSETS
        },
        "seen": sorted(provenance.seen),
        "cut_at": dict(provenance.segmentation_dead_zones),
        "seed": provenance.seed,
        "settings": dict(provenance.settings),
        "versions": dict(provenance.versions),
        "set_by_hand": {direction: dict(values) for direction, values in provenance.set_by_hand.items()},
        **_describe_adapted(provenance),
    }


def _describe_adapted(provenance: Provenance) -> dict[str, object]:
    """Return what adaptation changed; nothing of a model as identified, whose digest stays."""
    adapted = {direction: dict(changes) for direction, changes in provenance.adapted.items()}
    return {"adapted": adapted} if adapted else {}


def deployed_tensors(hitch: Hitch) -> dict[str, np.ndarray]:
    """Return the arrays of the channels, `direction/part/path`."""
    parts = [channel_tensors(channel, direction) for direction, channel in hitch.channels.items()]
    return {name: array for component in parts for name, array in component.items()}


def read_hitch(content: dict[str, Any], tensors: Tensors) -> Hitch:
    """Return the model of a description and its tensors.

    Raises:
        ValueError, KeyError, TypeError: the description or the tensors are not those of a model.
        InputError: a structure or a baseline of the model is not installed.
    """
    identification, validation, held_out = (
        {direction: tuple(names) for direction, names in content["split"][subset].items()}
        for subset in SUBSETS
    )
    provenance = Provenance(
        identification=identification,
        validation=validation,
        held_out=held_out,
        seen=frozenset(content["seen"]),
        segmentation_dead_zones=content["cut_at"],
        seed=content["seed"],
        settings=content["settings"],
        versions=content["versions"],
        set_by_hand=content["set_by_hand"],
        adapted=content.get("adapted", {}),
        digest=content["digest"],
    )
    return Hitch(
        {
            direction: read_channel(direction, described, tensors, direction)
            for direction, described in content["channels"].items()
        },
        content["step_s"],
        content["units"],
        provenance,
        content["drift"],
        _TWO_MODES.validate_python(content["two_modes"]),
        {
            direction: _UNCERTAINTY.validate_python(described)
            for direction, described in content["uncertainty"].items()
        },
    )
