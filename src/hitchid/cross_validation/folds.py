"""Division of the tests of a campaign into folds, by operating point."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchid.data.campaign import Campaign
from hitchid.data.record import CYCLE, Record
from hitchid.errors import InputError
from hitchid.identification.candidates import operating_points


@dataclass(frozen=True)
class Fold:
    """One division of a campaign.

    Attributes:
        training: everything but the held-out tests, of which no other copy is in it; nothing is held out.
        held_out: the held-out tests alone.
    """

    training: Campaign
    held_out: Campaign


def divide(campaign: Campaign, count: int, seed: int) -> tuple[Fold, ...]:
    """Return folds such that each test is held out in one of them.

    The tests of each direction are dealt separately, all tests of one operating point to the same fold; of a
    campaign of mixed cycles alone the cycles are. Ramps are never held out.

    Args:
        campaign: its own division into tests for identification and held-out tests is not used.
        count: number of folds.
        seed: of the order in which operating points are dealt.

    Raises:
        InputError: a direction has fewer operating points than there are folds.
    """
    rng = np.random.default_rng(seed)
    held_out: list[list[Record]] = [[] for _ in range(count)]
    for kind in campaign.directions or (CYCLE,):
        records = campaign.of_kind(kind)
        points = _operating_points(campaign, kind)
        present = np.unique(points)
        if present.size < count:
            raise InputError(
                f"folds: expected at most {present.size} for {len(records)} {kind} tests at {present.size} "
                f"operating points, got {count}"
            )
        folds = np.arange(present.size) % count
        fold_of_point = dict(zip(rng.permutation(present).tolist(), folds.tolist(), strict=True))
        for record, point in zip(records, points.tolist(), strict=True):
            held_out[fold_of_point[point]].append(record)
    return tuple(_fold(campaign, records) for records in held_out)


def _operating_points(campaign: Campaign, kind: str) -> np.ndarray:
    """Return the index of the operating point of each test of one kind, shape [T].

    As in the choice of a structure, tests at one level of command share a point, unless a covariate may
    differ between them. Every mixed cycle is a point of its own.
    """
    records = campaign.of_kind(kind)
    if kind == CYCLE:
        return np.arange(len(records))
    levels = np.array([_level(record.command(kind)) for record in records])
    return operating_points(levels, separate_tests=bool(campaign.covariates))


def _level(command: np.ndarray) -> float:
    """Return the mean magnitude of a command where it is not zero."""
    magnitude = np.abs(command)
    return float(magnitude[magnitude > 0].mean())


def _fold(campaign: Campaign, held_out: Sequence[Record]) -> Fold:
    fingerprints = {record.fingerprint for record in held_out}
    training = replace(campaign.without(fingerprints), test_patterns=(), unmatched=())
    return Fold(training, replace(campaign, records=tuple(held_out), test_patterns=None, unmatched=()))
