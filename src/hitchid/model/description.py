"""Conversion between a model and JSON and tensors."""

from dataclasses import asdict

import numpy as np

from hitchid.model.channel_description import channel_tensors, describe_channel, read_channel
from hitchid.model.hitch import Hitch
from hitchid.model.provenance import Provenance
from hitchid.model.schema import SCHEMA, ModelDescription
from hitchid.model.tensors import Tensors

SUBSETS = ("identification", "validation", "held_out")


def describe(hitch: Hitch) -> dict[str, object]:
    """Return the model without its trained arrays as content for JSON."""
    provenance = hitch.provenance
    return {
        "schema": SCHEMA,
        "kind": ModelDescription.KIND,
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


def read_hitch(described: ModelDescription, tensors: Tensors) -> Hitch:
    """Return the model of a description and its tensors.

    Raises:
        ValueError: the tensors are not those of the model.
    """
    provenance = Provenance(
        **{subset: getattr(described.split, subset) for subset in SUBSETS},
        seen=described.seen,
        segmentation_dead_zones=described.cut_at,
        seed=described.seed,
        settings=described.settings.model_dump(exclude_unset=True),
        versions=described.versions,
        set_by_hand=described.set_by_hand,
        adapted=described.adapted,
        digest=described.digest,
    )
    return Hitch(
        {
            direction: read_channel(direction, channel, tensors, direction)
            for direction, channel in described.channels.items()
        },
        described.step_s,
        described.units,
        provenance,
        described.drift,
        described.two_modes,
        described.uncertainty,
    )
