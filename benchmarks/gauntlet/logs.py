"""What a logger makes of a run: clock, sensor, columns, files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

Rng = np.random.Generator


@dataclass(frozen=True)
class Clock:
    """Time stamps.

    Attributes:
        step_s: sampling time.
        jitter: share of the step by which a stamp may be early or late.
        gaps: how many stretches are missing.
    """

    step_s: float
    jitter: float = 0.0
    gaps: int = 0

    def stamps(self, rng: Rng, samples: int) -> np.ndarray:
        """Return increasing stamps, shape [N]."""
        offsets = rng.uniform(-self.jitter, self.jitter, samples) if self.jitter else 0.0
        stamps = self.step_s * (np.arange(samples) + offsets)
        return stamps - stamps[0]

    def present(self, rng: Rng, samples: int) -> np.ndarray:
        """Tell which samples are not in a gap, shape [N]."""
        present = np.ones(samples, dtype=bool)
        for _ in range(self.gaps):
            length = int(rng.integers(3, max(4, samples // 12)))
            first = int(rng.integers(samples // 4, 3 * samples // 4))
            present[first : first + length] = False
        return present


@dataclass(frozen=True)
class Sensor:
    """Faults of a displacement sensor, each a share of the travel of a test.

    Attributes:
        noise: standard deviation.
        quantum: resolution.
        drift: how far zero has moved at the end.
        spikes: share of samples that are far off.
        ceiling: share of the travel beyond which it reads the same; 1 for none.
    """

    noise: float = 0.0
    quantum: float = 0.0
    drift: float = 0.0
    spikes: float = 0.0
    ceiling: float = 1.0

    def measure(self, rng: Rng, displacement: np.ndarray, travel: float) -> np.ndarray:
        """Return what is logged of a displacement, shape [N]."""
        count = displacement.size
        if self.ceiling < 1:
            low, high = displacement.min(), displacement.max()
            middle, half = (low + high) / 2, self.ceiling * (high - low) / 2
            displacement = np.clip(displacement, middle - half, middle + half)
        logged = displacement + travel * self.noise * rng.standard_normal(count)
        logged = logged + travel * self.drift * np.linspace(0.0, 1.0, count)
        hit = rng.random(count) < self.spikes
        logged = np.where(hit, logged + travel * rng.choice([-0.5, 0.5], count), logged)
        quantum = travel * self.quantum
        return np.round(logged / quantum) * quantum if quantum else logged


@dataclass(frozen=True)
class Columns:
    """How commands and displacement stand in the file.

    Attributes:
        layout: `two columns`, `signed`, or the one direction that has a column.
        command_unit, displacement_unit: of both.
        zero: reading of the command that means none.
        scale: command's unit per reading; negative where the sign is turned.
        displacement_scale: displacement's unit per reading.
    """

    layout: str
    command_unit: str
    displacement_unit: str
    zero: float = 0.0
    scale: float = 1.0
    displacement_scale: float = 1.0

    @property
    def _roles(self) -> dict[str, str]:
        """Return role to the name of its column."""
        if self.layout == "signed":
            return {"command": "valve"}
        two_columns = {"lifting_command": "valve up", "lowering_command": "valve down"}
        return two_columns if self.layout == "two columns" else {f"{self.layout}_command": "valve"}

    def table(self, time_s: np.ndarray, command: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """Return time, commands as read, displacement as read, shape [N, 3 or 4]."""
        sides = [np.maximum(command, 0.0), np.maximum(-command, 0.0)]
        if self.layout == "signed":
            sides = [command]
        elif self.layout != "two columns":
            sides = [sides[0] if self.layout == "lifting" else sides[1]]
        readings = [side / self.scale + self.zero for side in sides]
        return np.column_stack([time_s, *readings, displacement / self.displacement_scale])

    @property
    def header(self) -> str:
        """Return the first line of a log."""
        return ",".join(["Time", *self._roles.values(), "Position"])

    def settings(self) -> str:
        """Return `campaign.toml`."""
        command_suffix = f", zero = {self.zero!r}" if self.zero else ""
        command_suffix += f", scale = {self.scale!r}" if self.scale != 1 else ""
        lines = ["[signals]", 'time = { column = "Time", unit = "s" }']
        lines += [
            f'{role} = {{ column = "{name}", unit = "{self.command_unit}"{command_suffix} }}'
            for role, name in self._roles.items()
        ]
        displacement_suffix = f", scale = {self.displacement_scale!r}" if self.displacement_scale != 1 else ""
        lines.append(
            f'displacement = {{ column = "Position", unit = "{self.displacement_unit}"'
            f"{displacement_suffix} }}"
        )
        return "\n".join([*lines, ""])

    def write(self, path: Path, time_s: np.ndarray, command: np.ndarray, displacement: np.ndarray) -> None:
        """Write one log as CSV."""
        table = self.table(time_s, command, displacement)
        np.savetxt(path, table, delimiter=",", header=self.header, comments="", fmt="%.10g")
