"""Plants known in closed form: partial fractions of G(s), exact for a command held between two instants."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Controller = Callable[[int, float], float]


@dataclass(frozen=True)
class Valve:
    """From the command to what flows: play, dead zone, opening curve, saturation.

    u = sign(p)·max(|p| − d + h/2, 0), p the command with play ± h/2; w = C (u/C)ⁿ, at most `saturation`.

    Attributes:
        dead_zone, play: d and h, in the command's unit; h ≤ d.
        exponent: n.
        saturation: largest w, in the command's unit.
        full: C, the command at which every exponent gives the same flow.
    """

    dead_zone: float = 0.0
    play: float = 0.0
    exponent: float = 1.0
    saturation: float = np.inf
    full: float = 1.0

    def flow(self, spool: float) -> float:
        """Return w of a spool at p, in the command's unit."""
        excess = max(abs(spool) - self.dead_zone + self.play / 2, 0.0)
        curved = self.full * (excess / self.full) ** self.exponent
        return float(np.sign(spool)) * min(curved, self.saturation)

    def spool(self, previous: float, command: float) -> float:
        """Return p after a command, from p before it."""
        return min(max(previous, command - self.play / 2), command + self.play / 2)


@dataclass(frozen=True)
class Dynamics:
    """G(s) = Σ rᵢ/(s − λᵢ) from flow to travel, with a dead time.

    Attributes:
        poles, residues: λᵢ and rᵢ, all different, in 1/s.
        dead_time_s: in s.
    """

    poles: tuple[complex, ...]
    residues: tuple[complex, ...]
    dead_time_s: float = 0.0


def integrator(dead_time_s: float = 0.0) -> Dynamics:
    """Return 1/s."""
    return Dynamics((0.0,), (1.0,), dead_time_s)


def integrator_first_order(lag_s: float, dead_time_s: float = 0.0) -> Dynamics:
    """Return 1/(s (τ s + 1)) = 1/s − 1/(s + 1/τ)."""
    return Dynamics((0.0, -1 / lag_s), (1.0, -1.0), dead_time_s)


def integrator_second_order(frequency: float, damping: float, dead_time_s: float = 0.0) -> Dynamics:
    """Return 1/(s (s²/ω² + 2 ξ s/ω + 1)); ξ = 1 has a double pole and is not among them."""
    root = np.sqrt(complex(damping**2 - 1))
    first, second = frequency * (-damping + root), frequency * (-damping - root)
    return Dynamics(
        (0.0, first, second),
        (1.0, frequency**2 / (first * (first - second)), frequency**2 / (second * (second - first))),
        dead_time_s,
    )


def first_order_lag(lag_s: float, dead_time_s: float = 0.0) -> Dynamics:
    """Return τ/(τ s + 1): at first as fast as an integrator."""
    return Dynamics((-1 / lag_s,), (1.0,), dead_time_s)


@dataclass(frozen=True)
class Plant:
    """One axis: a valve for each sign of the command, dynamics, end stops.

    Attributes:
        dynamics: from the speed demanded to travel.
        valves: for positive and for negative commands.
        gains: speed per command of each, in the displacement's unit/(s·command's unit).
        stops: lowest and highest displacement.
    """

    dynamics: Dynamics
    valves: tuple[Valve, Valve]
    gains: tuple[float, float]
    stops: tuple[float, float] = (-np.inf, np.inf)

    def run(
        self, time_s: np.ndarray, commands: np.ndarray | Controller, start: float, load: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement at each instant, and the commands.

        Args:
            time_s: increasing instants, shape [N].
            commands: positive lifts; each holds from its instant to the next. Or what gives them from the
                number of the sample and the displacement then.
            start: displacement at rest.
            load: factor on the speed.
        """
        inputs = np.zeros(time_s.size) if callable(commands) else np.asarray(commands, float)
        travel, displacement = [start], start
        modes, spools, speeds = [0j] * len(self.dynamics.poles), [0.0, 0.0], []
        dead_time_s = self.dynamics.dead_time_s
        due_index = 0
        for number, (instant, next_instant) in enumerate(pairwise(time_s.tolist())):
            if callable(commands):
                inputs[number] = commands(number, displacement)
            speeds.append(load * self._speed(spools, float(inputs[number])))
            for begin, end, speed in self._constant_speed_intervals(
                time_s, speeds, instant - dead_time_s, next_instant - dead_time_s, due_index
            ):
                output_before = self._output(modes)
                modes = self._advance_modes(modes, end - begin, speed)
                displacement = float(np.clip(displacement + self._output(modes) - output_before, *self.stops))
            while due_index + 1 < len(speeds) and time_s[due_index + 1] <= next_instant - dead_time_s:
                due_index += 1
            travel.append(displacement)
        if callable(commands):
            inputs[-1] = commands(time_s.size - 1, displacement)
        return np.array(travel), inputs

    def _speed(self, spools: list[float], command: float) -> float:
        """Return the speed demanded by a command, moving the spools along."""
        total = 0.0
        for side, (valve, gain, sign) in enumerate(zip(self.valves, self.gains, (1, -1), strict=True)):
            spools[side] = valve.spool(spools[side], max(sign * command, 0.0))
            total += sign * gain * valve.flow(spools[side])
        return total

    @staticmethod
    def _constant_speed_intervals(
        time_s: np.ndarray, speeds: Sequence[float], begin: float, end: float, due_index: int
    ) -> list[tuple[float, float, float]]:
        """Return stretches of one speed between two instants of the delayed clock: begin, end, speed."""
        intervals = []
        if begin < time_s[0]:
            intervals.append((begin, min(end, float(time_s[0])), 0.0))
            begin = float(time_s[0])
        while begin < end:
            next_change = float(time_s[due_index + 1]) if due_index + 1 < len(speeds) else np.inf
            if next_change > begin:
                intervals.append((begin, min(end, next_change), speeds[due_index]))
                begin = min(end, next_change)
            due_index += 1
        return intervals

    def _advance_modes(self, modes: list[complex], duration_s: float, speed: float) -> list[complex]:
        """Return z after ż = λ z + speed, speed held."""
        return [
            mode + duration_s * speed
            if pole == 0
            else np.exp(pole * duration_s) * mode + np.expm1(pole * duration_s) / pole * speed
            for mode, pole in zip(modes, self.dynamics.poles, strict=True)
        ]

    def _output(self, modes: list[complex]) -> float:
        return sum((r * z).real for r, z in zip(self.dynamics.residues, modes, strict=True))
