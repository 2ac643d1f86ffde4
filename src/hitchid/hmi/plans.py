"""Plans of the operator: a campaign, a file of commands, a closed loop."""

import re
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, field_validator, model_validator

from hitchid.bench import Rig, rig_limits
from hitchid.errors import InputError
from hitchid.hmi.project import NAME_PATTERN
from hitchid.logs import (
    COMMAND,
    DEFAULT_SIGNALS,
    DIRECTIONS,
    StrictSettings,
    describe_settings,
    parse_settings,
)

# Limits of what the bench loop may command and where it stops.

MARGIN = 0.02  # of the travel, beyond its ends before the loop stops, and left free by tests; chosen


class Limits(StrictSettings):
    """Limits of a source, as the limits file of a machine gives them.

    Attributes:
        lifting_command, lowering_command: largest of each.
        lowest_displacement, highest_displacement: ends of the travel.
        command_unit, displacement_unit: of both.
        sensor_silence_s: longest time without a displacement while something moves, s; None for three
            sampling times as measured before, 0.05 s at least.
    """

    lifting_command: float = Field(gt=0, allow_inf_nan=False)
    lowering_command: float = Field(gt=0, allow_inf_nan=False)
    lowest_displacement: float = Field(allow_inf_nan=False)
    highest_displacement: float = Field(allow_inf_nan=False)
    command_unit: str = "A"
    displacement_unit: str = "mm"
    # At most a second: a machine that is driven without a measured displacement may run into its stops.
    sensor_silence_s: float | None = Field(default=None, gt=0, le=1)

    @model_validator(mode="after")
    def _ordered(self) -> "Limits":
        if not self.lowest_displacement < self.highest_displacement:
            raise ValueError("lowest_displacement must be below highest_displacement")
        return self

    @property
    def commands(self) -> tuple[float, float]:
        """Largest lifting and lowering command."""
        return self.lifting_command, self.lowering_command

    @property
    def displacement(self) -> tuple[float, float]:
        """Lowest and highest displacement."""
        return self.lowest_displacement, self.highest_displacement

    @property
    def travel(self) -> float:
        """Difference of highest and lowest displacement."""
        return self.highest_displacement - self.lowest_displacement

    def is_beyond(self, displacement: float) -> bool:
        """Return whether a displacement is outside by more than the margin."""
        low, high = self.displacement
        # So put that a displacement that is no number is beyond as well.
        return not low - MARGIN * self.travel <= displacement <= high + MARGIN * self.travel

    def describe(self) -> dict[str, object]:
        """Return the limits as content for JSON."""
        return {
            "lifting_command": self.lifting_command,
            "lowering_command": self.lowering_command,
            "displacement": list(self.displacement),
            "units": {"command": self.command_unit, "displacement": self.displacement_unit},
        }


def limits_of_rig(rig: Rig) -> Limits:
    """Return the limits of a virtual bench: currents at which its valves are wide open, A; its stroke, mm."""
    limits = rig_limits(rig)
    return Limits(
        lifting_command=limits.lifting_saturation_a,
        lowering_command=limits.lowering_saturation_a,
        lowest_displacement=0.0,
        highest_displacement=1e3 * limits.stroke_m,
    )


def read_limits(path: Path) -> Limits:
    """Read a limits file.

    Raises:
        SettingsError: the file cannot be read, or a key is missing, unknown or wrong.
    """
    return parse_settings(path, Limits)


POSITIONING_S = 12.0  # s, of a move between two tests, for the estimate of the time left; chosen
MOST_SAMPLES = 1_000_000  # of a file of commands, to bound its memory; chosen
MOST_BYTES = 50_000_000  # of a file of commands: a million lines of 50 characters
GOAL = re.compile(r"(?:free run )?([0-9]*\.?[0-9]+) ?([^\s0-9]{1,10}) in ([0-9]*\.?[0-9]+) ?s")
Name = Annotated[str, Field(pattern=f"^{NAME_PATTERN}$")]


class CampaignPlan(StrictSettings):
    """Ramps that find the dead zones, then PRBS tests of each direction, then cycles of both.

    Attributes:
        name: of the folder in `campaigns`.
        directions: to excite; cycles excite both.
        ramps, ramp_s: number for each direction, and length, s.
        tests, test_s: PRBS tests for each direction, and length, s.
        cycles, cycle_s: mixed tests, and length, s.
        seed: of all random draws.
        unattended: go on without the operator's page; of a virtual bench only.
    """

    kind: Literal["campaign"] = "campaign"
    name: Name
    directions: tuple[Literal["lifting", "lowering"], ...] = DIRECTIONS
    ramps: int = Field(default=2, ge=1, le=20)
    ramp_s: float = Field(default=20.0, ge=2, le=600)
    tests: int = Field(default=4, ge=0, le=1000)
    test_s: float = Field(default=10.0, ge=2, le=600)
    cycles: int = Field(default=0, ge=0, le=1000)
    cycle_s: float = Field(default=60.0, ge=5, le=3600)
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    unattended: bool = False

    @field_validator("directions")
    @classmethod
    def _distinct(cls, directions: tuple[str, ...]) -> tuple[str, ...]:
        if not directions:
            raise ValueError("expected lifting, lowering or both")
        # In one order and once each: the draws of a seed do not depend on how they were given.
        return tuple(direction for direction in DIRECTIONS if direction in directions)

    @property
    def excited(self) -> tuple[str, ...]:
        """Directions whose ramps are needed."""
        # Cycles move both ways, and so need the dead zone and the speed of both.
        return DIRECTIONS if self.cycles else self.directions

    @property
    def total(self) -> int:
        """Number of logs."""
        return len(self.excited) * self.ramps + len(self.directions) * self.tests + self.cycles

    @property
    def duration_s(self) -> float:
        """Estimated time of the whole, s."""
        ramps = len(self.excited) * self.ramps * self.ramp_s
        tests = len(self.directions) * self.tests * self.test_s
        return ramps + tests + self.cycles * self.cycle_s + self.total * POSITIONING_S


class AdaptivePlan(StrictSettings):
    """A campaign that chooses its own tests; see `hitchid.hmi.adaptive`.

    Attributes:
        name: of the folder in `campaigns`.
        minutes: of bench time at most.
        goal: such as `free run 0.2 mm in 10 s`; None to go on until nothing is gained or time is over.
        resume: whether it goes on with a campaign of this name that was stopped.
        seed: of all random draws.
        unattended: go on without the operator's page; of a virtual bench only.
    """

    kind: Literal["adaptive"] = "adaptive"
    name: Name
    minutes: float = Field(default=15.0, gt=0, le=600)
    goal: str | None = None
    resume: bool = False
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    unattended: bool = False
    total: Literal[1] = 1

    @field_validator("goal")
    @classmethod
    def _readable(cls, text: str | None) -> str | None:
        if text is not None:
            read_goal(text)
        return text


class Goal(NamedTuple):
    """The largest root mean square error of free runs, in the displacement's unit, and their length, s."""

    error: float
    unit: str
    duration_s: float


def read_goal(text: str) -> Goal:
    """Return the goal of a campaign.

    Raises:
        ValueError: the text is not like `free run 0.2 mm in 10 s`.
    """
    match = GOAL.fullmatch(text.strip())
    if match is None or not (float(match[1]) > 0 and 2 <= float(match[3]) <= 600):
        raise ValueError(f"expected a goal like 'free run 0.2 mm in 10 s', of 2 to 600 s, got {text!r:.60}")
    return Goal(float(match[1]), match[2], float(match[3]))


class FilePlan(StrictSettings):
    """Commands from a file, from the present displacement: `time_s, lifting_command, lowering_command`.

    Attributes:
        name: of the log.
        campaign: folder in `campaigns`, which may exist; by default of the same name.
        file: in the project.
    """

    kind: Literal["file"] = "file"
    name: Name
    campaign: Name | None = None
    file: str
    unattended: Literal[False] = False
    total: Literal[1] = 1


class DrivePlan(StrictSettings):
    """Closed loop with a tuned controller; its target is set while it runs.

    Attributes:
        name: of the log in `drives`.
        controller: file in the project.
    """

    kind: Literal["drive"] = "drive"
    name: Name
    controller: str
    unattended: Literal[False] = False
    total: Literal[1] = 1


Plan = CampaignPlan | AdaptivePlan | FilePlan | DrivePlan
# By `kind`: an error then names the key of the plan that was meant, not those of all three.
_PLAN: TypeAdapter[Plan] = TypeAdapter(Annotated[Plan, Field(discriminator="kind")])


def read_plan(content: object) -> Plan:
    """Return the plan of a message.

    Raises:
        InputError: a key is missing, unknown or wrong.
    """
    try:
        return _PLAN.validate_python(content)
    except ValidationError as error:
        raise InputError(f"plan: {describe_settings(error)}") from error


def read_commands(path: Path, step_s: float) -> np.ndarray:
    """Return the commands of a file on a clock, each held until the next, shape [N, 2].

    Args:
        path: CSV with `time_s` and the columns of one or both commands: `lifting_command`, the same with a
            unit, or the default column of logs, as `hitchid design` writes it.
        step_s: sampling time, s.

    Raises:
        InputError: the file cannot be read, or a column is missing, negative, not finite or not rising in
            time.
    """
    try:
        if path.stat().st_size > MOST_BYTES:  # before it is read
            raise InputError(f"{path.name}: is larger than {MOST_BYTES / 1e6:g} MB; shorten it")
        with path.open(encoding="utf-8") as file:
            names = [name.strip() for name in file.readline().split(",")]
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name}: cannot be read: {error}; expected a CSV of numbers") from error
    given: list[int | None] = []
    for role in map(COMMAND.__getitem__, DIRECTIONS):
        default = getattr(DEFAULT_SIGNALS, role).column
        matching = (number for number, name in enumerate(names) if name == default or name.startswith(role))
        given.append(next(matching, None))
    if names[:1] != ["time_s"] or given == [None, None] or rows.shape[1] != len(names) or len(rows) < 2:
        raise InputError(
            f"{path.name}: has the columns {', '.join(names)}; expected time_s first, then lifting_command, "
            "lowering_command or both"
        )
    time_s = rows[:, 0]
    commands = np.column_stack(
        [np.zeros(len(rows)) if column is None else rows[:, column] for column in given]
    )
    if not np.all(np.isfinite(rows)) or np.any(np.diff(time_s) <= 0) or np.any(commands < 0):
        raise InputError(f"{path.name}: expected finite numbers, rising times and commands of at least zero")
    # Refused before anything moves: the bench loop would stop the run at such a row.
    if np.any(np.all(commands > 0, axis=1)):
        raise InputError(f"{path.name}: commands both valves at once; expected one of them to be zero")
    # Two rows may be a year apart: the count is checked before memory is reserved for it.
    count = round((time_s[-1] - time_s[0]) / step_s) + 1
    if count > MOST_SAMPLES:
        raise InputError(f"{path.name}: has {count} samples; expected at most {MOST_SAMPLES}")
    clock = np.arange(count) * step_s + time_s[0]
    held = np.searchsorted(time_s, clock + 1e-6 * step_s, side="right") - 1  # against rounding of the times
    return commands[held]
