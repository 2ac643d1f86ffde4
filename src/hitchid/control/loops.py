"""Loops of one direction at its operating points, with drawn parameters, and their margins."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import expm, solve_discrete_are

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.control.axis import Axis
from hitchid.control.controller import Gains
from hitchid.control.prediction import SPEED_EXPONENT
from hitchid.errors import InputError
from hitchid.logs import LOWERING
from hitchid.model import Channel, Hitch, draws_of
from hitchid.structures import SmallSignal, discretise_delayed, small_signal_at, small_signals

# Frequency response of a hitch under its controller, open at the measurement: the loop of the margins.

FREQUENCIES = 460  # of a loop, up to half the sampling frequency; chosen
LOWEST_RAD_S = 0.01  # rad/s, below any crossing of a loop that settles within a minute; chosen


@short_repr
class PlantResponse(NamedTuple):
    """Response from current to displacement over frequency, exact for a current held between samples.

    Attributes:
        undelayed: without the dead time, shape [..., F].
        delay: of the dead time, shape [..., F].
        speed_gain: steady speed over current, shape [...].
    """

    undelayed: Complex[np.ndarray, "*s f"]
    delay: Complex[np.ndarray, "*s f"]
    speed_gain: Float[np.ndarray, "*s"]


def frequencies(step_s: float) -> Float[np.ndarray, " f"]:
    """Return the frequencies of a loop up to half the sampling frequency, rad/s."""
    return np.geomspace(LOWEST_RAD_S, np.pi / step_s, FREQUENCIES)


@double_precision
def plant_response(
    plant: SmallSignal, omega: Float[np.ndarray, " f"], step_s: float, *, exact_fraction: bool = True
) -> PlantResponse:
    """Return the response of linear models of one direction, one or S, over frequencies, rad/s.

    The dead time's fraction of a sample is exact, as a plant has it, else as of a controller that
    interpolates between samples.
    """
    # In samples, not in continuous time: hold, predictor and integral are as the controller has them.
    z = np.exp(1j * omega * step_s)
    a, b = np.asarray(plant.a), np.asarray(plant.b)
    dead_time = np.asarray(plant.dead_time_s)
    many = a.ndim > 2
    discretise = jax.vmap(discretise_delayed, (0, 0, 0, None)) if many else discretise_delayed
    whole = jax.tree.map(np.asarray, jax.jit(discretise)(a, b, 0.0 * dead_time, step_s))
    undelayed = _held(whole.transition, whole.gamma0[..., None, :] + 0j, z)
    samples = dead_time[..., None] / step_s
    # Rounding must not turn whole samples into one less and a fraction of nearly one.
    count = np.floor(samples + 1e-9)
    fraction = np.clip(samples - count, 0.0, 1.0)
    if exact_fraction:
        parts = jax.tree.map(np.asarray, jax.jit(discretise)(a, b, dead_time, step_s))
        # Within a sample the command of the one before acts first.
        inputs = parts.gamma0[..., None, :] + parts.gamma1[..., None, :] / z[:, None]
        delay = _held(parts.transition, inputs, z) / undelayed * z**-count
    else:
        delay = z**-count * (1 - fraction + fraction / z)
    lag_s = np.asarray(plant.spool_lag_s)[..., None]
    # Spools without a lag stand beside those with one; theirs is not to be divided by.
    safe = np.where(lag_s > 0, lag_s, 1.0)
    decay = np.where(lag_s > 0, np.exp(-step_s / safe), 0.0)
    share = np.where(lag_s > 0, safe / step_s * (1 - decay), 0.0)
    spool = 1 - share + share * (1 - decay) / (z - decay)
    gain = np.asarray(plant.gain)[..., None]
    # Speed under a constant current, all states but the position being at rest.
    steady = -np.linalg.solve(a[..., 1:, 1:], b[..., 1:, None])
    slope = b[..., 0] + (a[..., :1, 1:] @ steady)[..., 0, 0]
    return PlantResponse(gain * spool * undelayed, delay, gain[..., 0] * slope)


def open_loop(
    gains: Gains, plant: PlantResponse, model: PlantResponse, omega: Float[np.ndarray, " f"], step_s: float
) -> Complex[np.ndarray, "*s f"]:
    """Return the loop L = C S P/(1 + S (C (M₀ − M) + (k_v D + k_a D²) M₀)), open at the measurement.

    C = k_p + k_i h z/(z − 1), D = (1 − z⁻¹)/h, S the inverse of the valve's slope in the model, P one or S
    plants, M₀ and M the controller's model without and with the dead time; see `HitchController`.
    """
    z = np.exp(1j * omega * step_s)
    controller = float(gains.proportional) + float(gains.integral) * step_s * z / (z - 1)
    # The controller divides by the slope of its own model; the plant's slope differs, and is in the loop.
    inverse = 1 / model.speed_gain[..., None]
    predictor = controller * model.undelayed * (1 - model.delay)
    difference = (1 - 1 / z) / step_s
    inner = model.undelayed * (float(gains.speed) * difference + float(gains.acceleration) * difference**2)
    return controller * inverse * plant.undelayed * plant.delay / (1 + inverse * (predictor + inner))


def _held(
    transition: Float[np.ndarray, "*s n n"],
    inputs: Complex[np.ndarray, "*s _ n"],
    z: Complex[np.ndarray, " f"],
) -> Complex[np.ndarray, "*s f"]:
    """Return x₁ of (z − Φ)⁻¹ Γ."""
    system = z[:, None, None] * np.eye(transition.shape[-1]) - transition[..., None, :, :]
    vectors = np.broadcast_to(inputs, system.shape[:-1])[..., None]
    return np.linalg.solve(system, vectors)[..., 0, 0]


# Stability margins of a sampled loop from its frequency response, the dead time included exactly.


@short_repr
class Margins(NamedTuple):
    """Stability margins of loops, each of shape [...].

    Attributes:
        gain_db: smallest factor on the loop, dB, that makes it unstable; negative for an unstable loop.
        phase_deg: smallest lag that makes it unstable, °; negative for an unstable loop.
        delay_s: smallest further dead time that makes it unstable, s; zero for an unstable loop.
        sensitivity: Ms, largest magnitude of the sensitivity 1/(1 + L).
        disk: symmetric disk margin α (Seiler, Packard & Gahinet 2020, An introduction to disk margins).
    """

    gain_db: Float[np.ndarray, "*b"]
    phase_deg: Float[np.ndarray, "*b"]
    delay_s: Float[np.ndarray, "*b"]
    sensitivity: Float[np.ndarray, "*b"]
    disk: Float[np.ndarray, "*b"]


def margins(loop: Complex[np.ndarray, "*b f"], omega: Float[np.ndarray, " f"]) -> Margins:
    """Return the margins of loops whose poles are stable but for integrators.

    Gain: −20 log₁₀ abs(L) at the crossings of −180°, the smallest. Phase: arg L + 180° where abs(L) falls
    through one, the smallest, from −180 to 180°. Delay: that angle over the frequency, none where it is
    negative. Crossings are interpolated along straight lines between frequencies.

    Args:
        loop: response L of the open loop.
        omega: ascending frequencies, rad/s, shape [F].
    """
    # Unwrapped, since a crossing of −180° is a jump of the angle.
    phase = np.unwrap(np.angle(loop), axis=-1)
    # Half a sample of dead time leaves nothing at the Nyquist frequency, whose logarithm would be infinite.
    log_size = np.log(np.maximum(np.abs(loop), np.finfo(float).tiny))
    # The phase less the nearest odd multiple of −180°, which is zero at a crossing and jumps by 2π elsewhere.
    remainder, gains_db = (phase + 2 * np.pi) % (2 * np.pi) - np.pi, -20 / np.log(10) * log_size
    changes_sign = np.sign(remainder[..., :-1]) != np.sign(remainder[..., 1:])
    crosses = changes_sign & (np.abs(np.diff(remainder, axis=-1)) < np.pi)
    at_crossing = gains_db[..., :-1] + _share(remainder) * np.diff(gains_db, axis=-1)
    gain_db = np.where(crosses, at_crossing, np.inf).min(axis=-1)
    falls = (log_size[..., :-1] >= 0) & (log_size[..., 1:] < 0)
    share = _share(log_size)
    angle = np.rad2deg(phase[..., :-1] + share * np.diff(phase, axis=-1)) + 180.0
    frequency = omega[:-1] + share * np.diff(omega)
    signed = (angle + 180.0) % 360.0 - 180.0
    phase_deg = np.where(falls, signed, np.inf).min(axis=-1)
    delay_s = np.where(falls, np.deg2rad(np.maximum(signed, 0.0)) / frequency, np.inf).min(axis=-1)
    difference = 1 + loop
    sensitivity = np.max(1 / np.abs(difference), axis=-1)
    disk = np.min(2 * np.abs(difference) / np.abs(1 - loop), axis=-1)
    return Margins(*map(np.asarray, (gain_db, phase_deg, delay_s, sensitivity, disk)))


def _share(values: Float[np.ndarray, "*b f"]) -> Float[np.ndarray, "*b g"]:
    """Return where between two samples a line through them is zero, 0 to 1 where it is."""
    change = np.diff(values, axis=-1)
    return np.clip(-values[..., :-1] / np.where(change == 0, 1.0, change), 0.0, 1.0)


# Gains of a position controller at a bandwidth, by two methods.

INTEGRAL_RATIO = 8.0  # k_p²/k_i; 4 is a double closed-loop pole of an integrator, 8 overshoots less; chosen
Lags = tuple[float, float]  # a₁ and a₂ of the speed's denominator 1 + a₁ s + a₂ s², s and s²


def pi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains of PI control of an integrator at a bandwidth, rad/s."""
    # Both methods are called alike.
    del lags, step_s
    return Gains(bandwidth, bandwidth**2 / INTEGRAL_RATIO)


def lqi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains that minimise Σ e² + (ω/ρ ∫e)² + (v/ω)² for y' = s, s + a₁ s' + a₂ s'' = v.

    The states are the integral of the error, the position, the speed s and the acceleration; ω is the
    bandwidth, rad/s.
    """
    # A lag far below the sampling time would leave the Riccati equation without a solution.
    a1, a2 = max(lags[0], step_s), max(lags[1], step_s**2)
    a = np.zeros((4, 4))
    a[[0, 1, 2], [1, 2, 3]] = 1.0
    a[3, 2:] = -1 / a2, -a1 / a2
    b = np.array([[0.0], [0.0], [0.0], [1 / a2]])
    # Exact for a speed command that is held over a sample.
    block = expm(step_s * np.block([[a, b], [np.zeros((1, 5))]]))
    transition, held = block[:4, :4], block[:4, 4:]
    weights = np.diag([(bandwidth / INTEGRAL_RATIO) ** 2, 1.0, 0.0, 0.0])
    cost = np.array([[bandwidth**-2]])
    riccati = solve_discrete_are(transition, held, weights, cost)
    feedback = np.linalg.solve(cost + held.T @ riccati @ held, held.T @ riccati @ transition)
    integral, position, speed, acceleration = feedback[0].tolist()
    return Gains(position, integral, speed, acceleration)


GainsOf = Callable[[float, Lags, float], Gains]
METHODS: Mapping[str, GainsOf] = {"PI": pi_gains, "LQI": lqi_gains}


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
        # A heavier load is lowered faster, which costs margins; lifted more slowly, it costs none.
        faster = (1 + HEAVIER) ** SPEED_EXPONENT if direction == LOWERING else 1.0
        for command, displacement in operating_points(channel):
            nominal = small_signal_at(here, command, displacement)
            point = map(jnp.asarray, (vectors, row, command, displacement))
            drawn = small_signals(channel.benchmark, *point)
            models.append(plant_response(nominal, omega, model.step_s, exact_fraction=False))
            loaded = drawn._replace(gain=faster * np.asarray(drawn.gain))
            # The nominal model stands before the drawn ones.
            join = lambda one, rows: np.concatenate([np.asarray(one)[None], np.asarray(rows)])  # noqa: E731
            both = jax.tree.map(join, nominal, loaded)
            plants.append(plant_response(both, omega, model.step_s))
        # Behind the parameters of the structure stands the dead time.
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
        # Of Ms, the fourth, the largest is the worst.
        nominal = Margins(*(r.max() if n == 3 else r.min() for n, r in enumerate(first)))
        return DirectionMargins(nominal, worst, self.dead_time_s)


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
    axis = Axis.of(
        channel.benchmark,
        sign=channel.sign,
        dead_zone=channel.dead_zone,
        step_s=model.step_s,
        largest_command=channel.dead_zone + float(channel.operating_range.command.highest),
    )
    return axis.at_load(dict(zip(channel.benchmark.covariates, row.tolist(), strict=False)))
