"""Loops of one direction at its operating points, with drawn parameters, and their margins."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from hitchid.control.axis import Axis
from hitchid.control.controller import Gains
from hitchid.control.gain_design import Lags
from hitchid.control.margins import Margins, margins
from hitchid.control.open_loop import PlantResponse, frequencies, open_loop, plant_response
from hitchid.control.prediction import SPEED_EXPONENT
from hitchid.data.record import LOWERING
from hitchid.errors import InputError
from hitchid.model import Channel, Hitch
from hitchid.model.parameter_draws import draws_of
from hitchid.structures import SmallSignal, small_signal_at, small_signals

# Bars of the margins, which 95 % of the draws must meet at every operating point; Skogestad & Postlethwaite
# 2005, Multivariable Feedback Control, sec. 2.4.3, ask for Ms below 2, 6 dB and 30°.
MIN_GAIN_DB, MIN_PHASE_DEG, MAX_SENSITIVITY = 6.0, 45.0, 1.7
MIN_DEAD_TIMES = 2.0  # delay margin over the upper end of the dead time's interval
SHARE = 0.95  # of the draws
HEAVIER = 0.2  # load beyond that of the tests, with which a hitch is lowered faster; chosen
COMMAND_SHARES = (0.2, 0.5, 0.8)  # of the largest effective command: operating points; chosen
STROKE_SHARES = (0.1, 0.5, 0.9)  # of the displacement's range: operating points; chosen
# Errors below three standard deviations of the sensor noise open no valve. The speed that they ask for is at
# most 4 % of the largest; chosen: with more, noise moves the valves while a slow target is followed.
CROSSING_NOISE, NOISE_SHARE = 3.0, 0.04
MIN_NOISE_SHARE = 1e-4  # of the range of displacement, for a sensor without noise; chosen
MIDDLE = 4  # operating point in the middle of both


class DirectionMargins(NamedTuple):
    """Margins of one direction.

    Attributes:
        nominal: at the worst operating point with the identified parameters.
        worst: met by 95 % of the draws at every operating point.
        dead_time_s: upper end of the dead time's 95 % interval over draws, s.
    """

    nominal: Margins
    worst: Margins
    dead_time_s: float

    @property
    def passed(self) -> bool:
        """Whether the worst margins are within their bars."""
        worst = self.worst
        return bool(
            worst.gain_db >= MIN_GAIN_DB
            and worst.phase_deg >= MIN_PHASE_DEG
            and worst.sensitivity <= MAX_SENSITIVITY
            and worst.delay_s >= MIN_DEAD_TIMES * self.dead_time_s
        )


@dataclass(frozen=True)
class DirectionLoops:
    """Plants of one direction at its operating points, with drawn parameters.

    Attributes:
        direction: of the channel.
        lags: a₁ and a₂ of the denominator 1 + a₁ s + a₂ s² of the speed, s and s².
        step_s: sampling time, s.
        omega: frequencies, rad/s, shape [F].
        models: of the controller, at each operating point.
        plants: drawn, at each operating point, with a load that is heavier by `HEAVIER`; see `tune`.
        dead_time_s: upper end of the dead time's interval, s.
        vectors: drawn parameters, shape [S, R].
        noise_rad_s: bandwidth at which the noise of the sensor asks for `NOISE_SHARE` of the largest speed.
    """

    direction: str
    lags: Lags
    step_s: float
    omega: Float[np.ndarray, " f"]
    models: Sequence[PlantResponse]
    plants: Sequence[PlantResponse]
    dead_time_s: float
    vectors: Float[np.ndarray, "s r"]
    noise_rad_s: float

    @classmethod
    def of(
        cls, model: Hitch, direction: str, row: Float[np.ndarray, " c"], draws: int, seed: int
    ) -> "DirectionLoops":
        """Return the plants of a direction at values of its covariates."""
        channel = model.channels[direction]
        vectors = draws_of(model, direction, seed, draws)
        if vectors is None:
            raise InputError(
                f"model: its {direction} parameters have no standard errors, so that no margin can be given; "
                "identify it from more tests"
            )
        here, omega = channel.benchmark.at_load(jnp.asarray(row)), frequencies(model.step_s)
        models, plants = [], []
        faster = (1 + HEAVIER) ** SPEED_EXPONENT if direction == LOWERING else 1.0
        for command, displacement in operating_points(channel):
            nominal = small_signal_at(here, command, displacement)
            drawn = small_signals(
                channel.benchmark,
                jnp.asarray(vectors),
                jnp.asarray(row),
                jnp.asarray(command),
                jnp.asarray(displacement),
            )
            models.append(plant_response(nominal, omega, model.step_s, exact_fraction=False))
            loaded = drawn._replace(gain=faster * np.asarray(drawn.gain))
            plants.append(plant_response(_with_nominal(loaded, nominal), omega, model.step_s))
        dead_times_s = vectors[:, channel.benchmark.values.size]
        upper = float(np.quantile(dead_times_s, 0.975))
        axis = axis_of(model, channel, row)
        _, middle = tuple(operating_points(channel))[MIDDLE]
        fastest = float(axis.fastest(jnp.asarray(middle)))
        noise_rad_s = NOISE_SHARE * fastest / (CROSSING_NOISE * sensor_noise(model))
        return cls(direction, axis.lags, model.step_s, omega, models, plants, upper, vectors, noise_rad_s)

    def responses(self, gains: Gains) -> list[Complex[np.ndarray, "s f"]]:
        """Return the open loop at each operating point, the model's own first, then those of the draws."""
        return [
            open_loop(gains, plant, model, self.omega, self.step_s)
            for model, plant in zip(self.models, self.plants, strict=True)
        ]

    def margins_at_points(self, gains: Gains) -> list[Margins]:
        """Return the margins at each operating point, of the model first, then of each draw, [1 + S]."""
        return [margins(response, self.omega) for response in self.responses(gains)]

    def margins(self, gains: Gains) -> DirectionMargins:
        """Return the worst margins over operating points, of the model and of 95 % of the draws."""
        at_points = self.margins_at_points(gains)
        gain, phase, delay, sensitivity, disk = map(np.stack, zip(*at_points, strict=True))
        low = lambda rows: np.quantile(rows[:, 1:], 1 - SHARE, axis=1).min()  # noqa: E731
        worst = Margins(
            low(gain), low(phase), low(delay), np.quantile(sensitivity[:, 1:], SHARE, axis=1).max(), low(disk)
        )
        first = [rows[:, 0] for rows in (gain, phase, delay, sensitivity, disk)]
        nominal = Margins(*(r.max() if n == 3 else r.min() for n, r in enumerate(first)))
        return DirectionMargins(nominal, worst, self.dead_time_s)


def _with_nominal(drawn: SmallSignal, nominal: SmallSignal) -> SmallSignal:
    """Return the drawn linear models with the nominal one before them."""
    return jax.tree.map(
        lambda rows, one: np.concatenate([np.asarray(one)[None], np.asarray(rows)]), drawn, nominal
    )


def operating_points(channel: Channel) -> Iterator[tuple[float, float]]:
    """Yield effective command and displacement of the operating points."""
    highest = float(channel.operating_range.command.highest)
    displacement = channel.operating_range.displacement
    lowest, width = float(displacement.lowest), float(displacement.highest - displacement.lowest)
    nonlinearity = channel.benchmark.nonlinearity
    opening = 0.0 if nonlinearity is None else float(nonlinearity.opening_command)
    for command, place in product(COMMAND_SHARES, STROKE_SHARES):
        yield opening + command * (highest - opening), lowest + place * width


def sensor_noise(model: Hitch) -> float:
    """Return the standard deviation of the sensor noise, in the displacement's unit.

    Both directions have the same sensor; what a model misses makes its noise larger, so the smaller is it.
    The bands know it from the errors of held-out tests; the load filter, which splits them between sensor
    and load, may give the sensor too little.
    """
    channels = model.channels.items()
    ranges = (channel.operating_range.displacement for _, channel in channels)
    widest = max(float(own.highest - own.lowest) for own in ranges)
    noises = [
        model.bands[direction].noise if direction in model.bands else float(channel.load_filter.noise)
        for direction, channel in channels
    ]
    return max(MIN_NOISE_SHARE * widest, min(noises))


def axis_of(model: Hitch, channel: Channel, row: Float[np.ndarray, " c"]) -> Axis:
    """Return the axis of a channel at values of its covariates, up to the largest current of its tests."""
    largest_command = channel.dead_zone + float(channel.operating_range.command.highest)
    axis = Axis.of(
        channel.benchmark,
        sign=channel.sign,
        dead_zone=channel.dead_zone,
        step_s=model.step_s,
        largest_command=largest_command,
    )
    return axis.at_load(dict(zip(channel.benchmark.covariates, row.tolist(), strict=False)))
