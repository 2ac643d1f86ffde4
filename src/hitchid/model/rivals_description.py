"""Conversion between the rivals of a model and JSON and tensors."""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from hitchid.model.channel_description import channel_tensors, describe_channel, read_channel
from hitchid.model.rivals import Rivals
from hitchid.model.schema import Direction, RivalsOfDirection
from hitchid.model.tensors import Tensors, fill, shapes_of, tensors_of


def describe_rivals(rivals: Mapping[str, Rivals]) -> dict[str, object]:
    """Return the rivals of each direction without their arrays as content for JSON."""
    return {direction: _describe(of_direction) for direction, of_direction in rivals.items()}


def rivals_tensors(rivals: Mapping[str, Rivals]) -> dict[str, np.ndarray]:
    """Return the arrays of the rivals, `direction/baselines/…` and `direction/paper/…`."""
    tensors = {}
    for direction, of_direction in rivals.items():
        for name, fitted in of_direction.baselines.items():
            tensors |= tensors_of(fitted, f"{direction}/baselines/{name}")
        if of_direction.paper is not None:
            tensors |= channel_tensors(of_direction.paper, f"{direction}/paper")
    return tensors


def read_rivals(described: Mapping[Direction, RivalsOfDirection], tensors: Tensors) -> dict[str, Rivals]:
    """Return the rivals of each direction from their description and tensors.

    Raises:
        ValueError: the tensors are not those of rivals.
        InputError: a baseline is not installed.
    """
    return {direction: _read(direction, rivals, tensors) for direction, rivals in described.items()}


def _describe(rivals: Rivals) -> dict[str, object]:
    paper, estimates = rivals.paper, rivals.paper_estimates
    return {
        "baselines": list(rivals.baselines),
        "covariates": list(rivals.covariates),
        "paper": None if paper is None else describe_channel(paper),
        "paper_parameters": None if estimates is None else asdict(estimates),
        "searches": [asdict(search) for search in rivals.searches],
        "notices": list(rivals.notices),
        "trained": rivals.trained,
    }


def _read(direction: str, described: RivalsOfDirection, tensors: Tensors) -> Rivals:
    # Imported here: baselines import global searches and optimisers, which a deployed model does not need.
    from hitchid.baselines.registry import baseline_named

    baselines = {}
    for name in described.baselines:
        prefix = f"{direction}/baselines/{name}"
        skeleton = baseline_named(name).skeleton(shapes_of(tensors, prefix))
        baselines[name] = fill(skeleton, tensors, prefix)
    paper = described.paper
    return Rivals(
        baselines,
        None if paper is None else read_channel(direction, paper, tensors, f"{direction}/paper"),
        described.paper_parameters,
        described.searches,
        described.covariates,
        described.notices,
        described.trained,
    )
