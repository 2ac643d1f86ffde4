"""Operating characteristics of one direction: speed map, dead zone, opening, delay, response time."""

from dataclasses import dataclass, replace

from hitchid._support.short_repr import short_repr
from hitchid.model.estimates import Interval, Quantity

# Error up to which a speed is determined, as a share of it and of the fastest speed of the map; chosen.
SPEED_TOLERANCE, FASTEST_SPEED_TOLERANCE = 0.25, 0.05
TIME_RESOLUTION_SAMPLES = 2  # samples: an interval of a delay up to this width is determined; chosen


@short_repr
@dataclass(frozen=True)
class SpeedPoint:
    """Steady speed at one level of the command, at mid stroke.

    Attributes:
        command: size of the command as logged.
        load: the covariate before motion; None where the model has none.
        speed: positive in the direction of the command, in the displacement's unit per s.
        interval: 95 % interval; None for an end that the tests do not determine.
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
        """Create a point, determined or not by its interval; `fastest` is the fastest speed of the map."""
        lower, upper = interval
        tolerance = max(SPEED_TOLERANCE * speed, FASTEST_SPEED_TOLERANCE * fastest)
        determined = (
            lower is not None and upper is not None and max(speed - lower, upper - speed) <= tolerance
        )
        return cls(command, load, speed, interval, determined)

    def scaled(self, factor: float) -> "SpeedPoint":
        """Return the point with a factor on the gain."""
        lower, upper = self.interval
        scaled_interval = None if lower is None else factor * lower, None if upper is None else factor * upper
        return replace(self, speed=factor * self.speed, interval=scaled_interval)


@short_repr
@dataclass(frozen=True)
class MeasuredSpeed:
    """Mean speed of an identification test around mid stroke at a constant command.

    Attributes:
        command, load, speed: as in `SpeedPoint`, measured.
    """

    command: float
    load: float | None
    speed: float


@short_repr
@dataclass(frozen=True)
class Characteristics:
    """Operating characteristics of one direction, derived from the fitted model.

    Attributes:
        command_unit, speed_unit: units of all commands and speeds.
        load: name of the covariate; None where the model has none.
        dead_zone: dead zone of the command, from ramps or tests, or as given.
        opening: command at which flow begins; None where the model has no valve curve.
        level: size of the command step for delay and response time.
        delay: time from a command step at rest until the speed reaches 5 % of its final value, s; None
            where the model has neither dead time nor lag.
        response_time: the same until 63.2 %, delay included, s; None likewise.
        speed_map: steady speed at mid stroke at each level, for each load.
        measured: speeds measured in identification tests with a long enough constant command.
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
        """Return the characteristics with a factor on the gain; measured speeds are not changed."""
        return replace(self, speed_map=tuple(point.scaled(factor) for point in self.speed_map))
