"""Limits of what the bench loop may command and where it stops."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import Field, model_validator

from hitchid.data.signal_map import Strict, parse_settings
from hitchid.rig import Rig, rig_limits

MARGIN = 0.02  # of the travel, beyond its ends before the loop stops, and left free by tests; chosen


class LimitsFile(Strict):
    """The limits file of a machine: largest commands, lowest and highest displacement, longest silence."""

    lifting_command: float = Field(gt=0, allow_inf_nan=False)
    lowering_command: float = Field(gt=0, allow_inf_nan=False)
    lowest_displacement: float = Field(allow_inf_nan=False)
    highest_displacement: float = Field(allow_inf_nan=False)
    command_unit: str = "A"
    displacement_unit: str = "mm"
    sensor_silence_s: float = Field(default=0.05, gt=0, le=1)

    @model_validator(mode="after")
    def _ordered(self) -> "LimitsFile":
        if not self.lowest_displacement < self.highest_displacement:
            raise ValueError("lowest_displacement must be below highest_displacement")
        return self


@dataclass(frozen=True)
class Limits:
    """Limits of a source.

    Attributes:
        commands: largest lifting and lowering command.
        displacement: lowest and highest displacement.
        sensor_silence_s: longest time without a displacement while something moves, s.
        command_unit, displacement_unit: of both.
    """

    commands: tuple[float, float]
    displacement: tuple[float, float]
    sensor_silence_s: float = 0.05
    command_unit: str = "A"
    displacement_unit: str = "mm"

    @property
    def travel(self) -> float:
        """Difference of highest and lowest displacement."""
        return self.displacement[1] - self.displacement[0]

    def is_beyond(self, displacement: float) -> bool:
        """Return whether a displacement is outside by more than the margin."""
        low, high = self.displacement
        return not low - MARGIN * self.travel <= displacement <= high + MARGIN * self.travel

    def describe(self) -> dict[str, object]:
        """Return the limits as content for JSON."""
        lifting, lowering = self.commands
        return {
            "lifting_command": lifting,
            "lowering_command": lowering,
            "displacement": list(self.displacement),
            "units": {"command": self.command_unit, "displacement": self.displacement_unit},
        }


def limits_of_rig(rig: Rig) -> Limits:
    """Return the limits of a virtual bench: currents at which its valves are wide open, A; its stroke, mm."""
    limits = rig_limits(rig)
    return Limits((limits.lifting_saturation_a, limits.lowering_saturation_a), (0.0, 1e3 * limits.stroke_m))


def read_limits(path: Path) -> Limits:
    """Read a limits file.

    Raises:
        SettingsError: the file cannot be read, or a key is missing, unknown or wrong.
    """
    content = parse_settings(path, LimitsFile)
    return Limits(
        (content.lifting_command, content.lowering_command),
        (content.lowest_displacement, content.highest_displacement),
        content.sensor_silence_s,
        content.command_unit,
        content.displacement_unit,
    )
