"""What the operator of a plant wants to know of one direction: speed at each command, dead zone, delay."""

from dataclasses import dataclass, replace

from hitchid.model.estimates import Interval, Quantity

SPEED_TOLERANCE, FASTEST_SPEED_TOLERANCE = 0.25, 0.05
TIME_RESOLUTION_SAMPLES = 2


@dataclass(frozen=True)
class SpeedPoint:
    """Steady speed at one level of the command, at mid stroke.

    Attributes:
        command: size of the command as logged.
        load: the covariate before motion; None where the form has none.
        speed: the way the command drives, displacement's unit per s.
        interval: 95 %; None for an end that the tests do not give.
        determined: whether both ends lie within a quarter of the speed, or within a twentieth of the
            fastest one of the map.
    """

    command: float
    load: float | None
    speed: float
    interval: Interval
    determined: bool

    @classmethod
    def of(
        cls, command: float, load: float | None, speed: float, interval: Interval, fastest: float
    ) -> "SpeedPoint":
        """Judge by its interval whether a speed is determined; `fastest` is the fastest of the map."""
        lower, upper = interval
        tolerance = max(SPEED_TOLERANCE * speed, FASTEST_SPEED_TOLERANCE * fastest)
        determined = (
            lower is not None and upper is not None and max(speed - lower, upper - speed) <= tolerance
        )
        return cls(command, load, speed, interval, determined)

    def scaled(self, factor: float) -> "SpeedPoint":
        """Return it with a factor on the gain."""
        lower, upper = self.interval
        scaled_interval = None if lower is None else factor * lower, None if upper is None else factor * upper
        return replace(self, speed=factor * self.speed, interval=scaled_interval)


@dataclass(frozen=True)
class MeasuredSpeed:
    """Mean speed of an identification test around mid stroke while its command stood at one level.

    Attributes:
        command, load, speed: as in `SpeedPoint`, measured.
    """

    command: float
    load: float | None
    speed: float


@dataclass(frozen=True)
class Characteristics:
    """Operating characteristics of one direction, derived from the fitted form.

    Attributes:
        command_unit, speed_unit: of all commands and speeds.
        load: name of the covariate; None where the form has none.
        dead_zone: of the command, from ramps or tests, or as it was given.
        opening: the command at which flow begins, where the form has a valve curve.
        level: the command of the steps that delay and response time are told for.
        delay: from a step of the command at rest until the speed reaches 5 % of its final value, s; None
            where the form has neither dead time nor lag.
        response_time: from the step until it reaches 63.2 %, delay included, s; None likewise.
        speed_map: steady speed at mid stroke at each level, for each load.
        measured: what identification tests that stood at one level long enough show.
    """

    command_unit: str
    speed_unit: str
    load: str | None
    dead_zone: Quantity
    opening: Quantity | None
    level: float
    delay: Quantity | None
    response_time: Quantity | None
    speed_map: tuple[SpeedPoint, ...]
    measured: tuple[MeasuredSpeed, ...]

    def scaled(self, factor: float) -> "Characteristics":
        """Return them with a factor on the gain; what was measured stays."""
        return replace(self, speed_map=tuple(point.scaled(factor) for point in self.speed_map))
