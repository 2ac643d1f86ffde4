"""Command over steady speed, as a table for a controller."""

import csv
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid._support.files import write_bytes
from hitchid._support.precision import double_precision
from hitchid._support.screen import GAP, screen
from hitchid._support.tables import dataframe
from hitchid.errors import InputError
from hitchid.handover.speed import INSTEAD, centre, linear_channel, load_of_channel
from hitchid.logs.record import COMMAND, DISPLACEMENT
from hitchid.model.channel import Channel
from hitchid.model.inputs import Load, Numbers
from hitchid.structures import PhysicalModel, command_for_speed, opening_command, steady_speed

if TYPE_CHECKING:
    from pandas import DataFrame

    from hitchid.model.hitch import Hitch

ROWS = 33  # of a table, chosen: interpolated in between, a curve of the valve is met to about 1e-3
CHECKED_COMMANDS = 1001  # at which the speed map is checked to rise, chosen
ROUND_TRIP = 1e-9  # relative error of the speed at a command of the table
SHOWN_ROWS = 5  # of a table's `repr`, chosen


@dataclass(frozen=True, eq=False, repr=False)
class InverseTable:
    """Command over steady speed of one direction; the speeds ascend.

    Attributes:
        direction: lifting or lowering.
        speed: positive where the displacement grows, ascending, in `speed_unit`, shape [N].
        command: size of the command for each speed, in `command_unit`, shape [N]; at speed zero the command
            at which flow begins.
        speed_unit, command_unit: units.
    """

    direction: str
    speed: Float[np.ndarray, " n"]
    command: Float[np.ndarray, " n"]
    speed_unit: str
    command_unit: str

    def __len__(self) -> int:
        return self.speed.size

    def __repr__(self) -> str:
        rows = [
            f"{speed:.4g} {self.speed_unit}: {command:.4g} {self.command_unit}" for speed, command in self
        ]
        left_out = [f"… {len(self) - 2 * SHOWN_ROWS} more"] if len(rows) > 2 * SHOWN_ROWS else []
        if left_out:
            rows = [*rows[:SHOWN_ROWS], *left_out, *rows[-SHOWN_ROWS:]]
        return screen([f"InverseTable: {self.direction}, {len(self)} rows", *(f"{GAP}{row}" for row in rows)])

    def __iter__(self):
        """Return an iterator over pairs of speed and command."""
        return iter(zip(self.speed.tolist(), self.command.tolist(), strict=True))

    @property
    def columns(self) -> tuple[str, str]:
        """Names of the columns with their units, such as `speed_mm_per_s` and `command_A`."""
        return f"speed_{self.speed_unit.replace('/', '_per_')}", f"command_{self.command_unit}"

    def to_dataframe(self) -> "DataFrame":
        """Return the table as a pandas DataFrame with the names of `columns`.

        Raises:
            InputError: pandas is not installed.
        """
        return dataframe([dict(zip(self.columns, row, strict=True)) for row in self])

    def to_csv(self, path: str | Path, *, force: bool = False) -> None:
        """Write the table as CSV; numbers have the fewest digits that read back as the same number.

        Args:
            path: the file.
            force: replace an existing file.

        Raises:
            OutputError: the file exists and `force` is not given, or it cannot be written.
            InputError: `path` is not a path.
        """
        text = StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self])
        write_bytes(checks.path(path, "path"), text.getvalue().encode(), force=force)


@double_precision
def make_inverse_table(
    model: "Hitch",
    direction: str | None = None,
    speeds: Numbers | None = None,
    *,
    displacement: float | None = None,
    load: Load | None = None,
) -> InverseTable:
    """Return command over steady speed; see `Hitch.inverse_table`."""
    channel = linear_channel(model, direction, instead=INSTEAD)
    at_load = load_of_channel(channel, load)
    if at_load.ndim > 1:
        raise checks.input_error("load", "one load", load)
    inverse = _Inverse(
        channel,
        channel.benchmark.at_load(jnp.asarray(at_load)),
        centre(channel) if displacement is None else checks.number(displacement, "displacement"),
        f"{model.units[DISPLACEMENT]}/s",
        model.units[COMMAND[channel.direction]],
    )
    sizes = inverse.default_speeds() if speeds is None else inverse.checked_speeds(speeds)
    ascending = slice(None, None, channel.sign)
    return InverseTable(
        channel.direction,
        channel.sign * sizes[ascending] + 0.0,  # no negative zero
        inverse.commands(sizes)[ascending],
        inverse.speed_unit,
        inverse.command_unit,
    )


@dataclass(frozen=True)
class _Inverse:
    """The speed map of a channel at one displacement and load; all speeds are sizes."""

    channel: Channel
    physical_model: PhysicalModel
    displacement: float
    speed_unit: str
    command_unit: str

    def default_speeds(self) -> Float[np.ndarray, " n"]:
        """Return speeds from zero to that at the largest command of the tests."""
        highest = self.channel.dead_zone + float(self.channel.operating_range.command.highest)
        if not np.isfinite(highest):
            raise InputError(
                "speeds: the range of the test commands is not stored in this model, so there "
                "are no default speeds; give `speeds`"
            )
        fastest = self._speeds(np.array([highest]))[0]
        if not fastest > 0:
            raise InputError(
                "direction: the piston does not move at the largest command of the tests, "
                f"{highest:.4g} {self.command_unit}, at this displacement and load: the valve "
                "is closed there; choose another displacement or load, or give the speeds"
            )
        self._check_rising(highest)
        return np.unique(np.append(0.0, np.linspace(self._slowest(), fastest, ROWS)))

    def checked_speeds(self, speeds: Numbers) -> Float[np.ndarray, " n"]:
        """Return the sizes of signed speeds, ascending."""
        signed = np.atleast_1d(checks.numbers(speeds, "speeds"))
        sizes = np.unique(np.abs(signed))
        if signed.ndim > 1 or not signed.size or np.any(self.channel.sign * signed < 0):
            sense = "≥ 0" if self.channel.sign > 0 else "≤ 0"
            raise checks.input_error("speeds", f"speeds {sense} of {self.channel.direction}, one row", speeds)
        return sizes

    def commands(self, sizes: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the command of each speed, after checks that the speed map rises and is inverted."""
        slowest = self._slowest()
        jumped = sizes[(sizes > 0) & (sizes < slowest * (1 - ROUND_TRIP))]
        if jumped.size:
            raise InputError(
                f"speeds: no command gives {jumped[0]:.4g} {self.speed_unit}: when the valve "
                f"opens, the speed is already {slowest:.4g} {self.speed_unit}; expected zero or "
                "at least this speed"
            )
        commands = np.asarray(
            command_for_speed(
                self.physical_model,
                jnp.asarray(sizes),
                self.channel.dead_zone,
                self.displacement,
            )
        )
        unreached = sizes[~np.isfinite(commands)]
        if unreached.size:
            raise InputError(
                f"speeds: no command gives {unreached[0]:.4g} {self.speed_unit}, since the valve saturates; "
                "expected less"
            )
        # Only after the commands are known: a map that falls beyond them does no harm.
        self._check_rising(float(commands.max()))
        # The proof of an inverse, whatever way it was found.
        errors = np.abs(self._speeds(commands) - sizes)
        if np.any(errors > ROUND_TRIP * sizes) or np.any(np.diff(commands) <= 0):
            worst = sizes[int(np.argmax(errors - ROUND_TRIP * sizes))]
            raise InputError(
                f"speeds: the speed map is too flat at {worst:.4g} {self.speed_unit}: several "
                "commands give almost the same speed, so no command can be found within "
                f"{ROUND_TRIP:g} of this speed; choose other speeds"
            )
        return commands

    def _check_rising(self, highest: float) -> None:
        """Raise InputError unless the speed rises with the command from the opening on."""
        grid = np.linspace(self._begin(), highest, CHECKED_COMMANDS)
        flat = np.flatnonzero(np.diff(self._speeds(grid)) <= 0)
        if highest > grid[0] and flat.size:
            raise InputError(
                f"direction: the {self.channel.direction} speed does not increase with the "
                f"command between {grid[flat[0]]:.4g} and {grid[flat[-1] + 1]:.4g} "
                f"{self.command_unit}: the valve is closed or saturated there; choose lower "
                "speeds"
            )

    def _slowest(self) -> float:
        """Return the speed with which flow begins; above zero where the valve's curve begins with a jump."""
        return float(self._speeds(np.array([self._begin()]))[0])

    def _begin(self) -> float:
        """Return the smallest command at which the valve is open."""
        channel, nonlinearity = self.channel, self.channel.benchmark.nonlinearity
        opening = float(opening_command(self.physical_model, channel.dead_zone))
        if nonlinearity is None:
            return opening
        return max(opening, channel.dead_zone + float(nonlinearity.smallest_command))

    def _speeds(self, commands: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        model, dead_zone = self.physical_model, self.channel.dead_zone
        return np.asarray(steady_speed(model, jnp.asarray(commands), dead_zone, self.displacement))
