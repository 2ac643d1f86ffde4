"""Strokes cut from a running machine, sample by sample or block by block."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hitchid._support.records import short_repr
from hitchid.logs import ACTIVE_FRACTION, DIRECTIONS
from hitchid.model import Hitch
from hitchid.structures import REST_SAMPLES

ON_FRACTION = 0.8  # of the identified dead zone; a command beyond it may move the piston; chosen
SETTLE_S = 0.3  # s after the command ends that still belong to a stroke: several lags of a valve; chosen
LONGEST_S = 20.0  # s of a stroke that are kept; chosen, longer than a full stroke at a tenth of the flow
NONE, BOTH = -1, len(DIRECTIONS)  # beside the number of the direction whose command is active
ACTIVE = np.array([NONE, 0, 1, BOTH])  # by whether lifting is active, plus twice whether lowering is


@short_repr
class Stroke(NamedTuple):
    """One motion of one direction: rest before it, command, and what follows until it stands.

    Attributes:
        direction: of the command; empty where both commands were active.
        begin: number of the sample at which its command begins, since the start of the log.
        rest: samples before that.
        commands: lifting and lowering, in the model's units, shape [N, 2].
        displacement: measured; NaN where there is none, in the model's unit, shape [N].
    """

    direction: str
    begin: int
    rest: int
    commands: Float[np.ndarray, "n 2"]
    displacement: Float[np.ndarray, " n"]

    @property
    def end(self) -> int:
        """Number of the sample after its last one."""
        return self.begin - self.rest + len(self.displacement)


class StrokeCutter:
    """Cuts commands and displacements into strokes; where blocks begin and end makes no difference.

    A stroke begins with a command of one direction, and ends with that of the other or when there has been
    none for 0.3 s. Of a stroke longer than 20 s the rest is left out. Memory is that of one stroke.

    Args:
        model: identified hitch, whose dead zones and ranges tell which commands are active.
        first: number of the first sample.
    """

    def __init__(self, model: Hitch, first: int = 0) -> None:
        self._on = np.full(len(DIRECTIONS), np.inf)  # sizes of the commands above which the piston may move
        for direction, channel in model.channels.items():
            full_scale = channel.dead_zone + float(channel.operating_range.command.highest)
            least = max(ON_FRACTION * channel.dead_zone, ACTIVE_FRACTION * full_scale)
            self._on[DIRECTIONS.index(direction)] = least
        self._settle = max(1, round(SETTLE_S / model.step_s))
        self._longest = round(LONGEST_S / model.step_s)
        self._samples = first
        self._rows: list[np.ndarray] = []  # of the stroke, or of the rest before one: commands, displacement
        self._direction, self._begin, self._rest, self._inactive, self._kept = NONE, 0, 0, 0, 0

    def feed(self, commands: Float[np.ndarray, "b 2"], displacement: Float[np.ndarray, " b"]) -> list[Stroke]:
        """Return the strokes that end within a block of samples.

        Args:
            commands: lifting and lowering, in the model's units; what is not finite counts as none.
            displacement: measured; NaN where there is none.
        """
        active = self._active(commands)
        rows = np.concatenate([commands, displacement[:, None]], axis=1)
        # Piece by piece of one active command, so that where a block begins makes no difference.
        edges = [0, *(np.flatnonzero(active[1:] != active[:-1]) + 1).tolist(), len(active)]
        ended = []
        for start, stop in pairwise(edges):
            if stop > start:
                ended += self._run(int(active[start]), rows[start:stop])
        return ended

    def finish(self) -> list[Stroke]:
        """Return the stroke that is under way where the log ends, if there is one."""
        return [self._close()] if self.moves else []

    @property
    def moves(self) -> bool:
        """Whether a stroke has begun and not ended."""
        return self._direction != NONE

    def _active(self, commands: Float[np.ndarray, "b 2"]) -> Int[np.ndarray, " b"]:
        lifting, lowering = (np.abs(commands) > self._on).T
        return ACTIVE[lifting + 2 * lowering]

    def _run(self, active: int, rows: np.ndarray) -> list[Stroke]:
        """Take samples of one active command, or of none; return the strokes that end."""
        ended = []
        if self.moves and active == NONE:
            taken = min(self._settle - self._inactive, len(rows))
            self._append(rows[:taken])
            self._inactive += taken
            if self._inactive == self._settle:
                ended.append(self._close())
            rows = rows[taken:]
        elif self.moves and active != self._direction:
            ended.append(self._close())
        if not self.moves and active != NONE:
            self._rest = sum(map(len, self._rows))
            self._direction, self._begin, self._inactive = active, self._samples, 0
            self._kept = self._rest
        if len(rows) and active != NONE:
            self._inactive = 0
            self._append(rows)
        elif len(rows):
            self._samples += len(rows)
            self._rows = [np.concatenate([*self._rows, rows[-REST_SAMPLES:]])[-REST_SAMPLES:]]
        return ended

    def _append(self, rows: np.ndarray) -> None:
        """Take samples of the stroke; those beyond the longest stroke are left out."""
        self._samples += len(rows)
        # Counted, but not kept: numbers of later samples stay those of the log.
        kept = rows[: max(self._longest - self._kept, 0)]
        if len(kept):
            self._rows.append(kept)
            self._kept += len(kept)

    def _close(self) -> Stroke:
        """Return the stroke that ends; its last samples are the rest before the next one."""
        rows = np.concatenate(self._rows)
        direction = "" if self._direction == BOTH else DIRECTIONS[self._direction]
        # A stroke that was cut has lost the samples after it: what it ends with is motion, not rest.
        settled = min(self._inactive, REST_SAMPLES) if self._kept < self._longest else 0
        self._rows = [rows[len(rows) - settled :]]
        self._direction = NONE
        return Stroke(direction, self._begin, self._rest, rows[:, :2], rows[:, 2])
