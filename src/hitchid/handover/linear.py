"""Linear model of one direction of a hitch about an operating point, with draws of its parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid._support.checks import named_arguments
from hitchid._support.precision import double_precision
from hitchid._support.tables import Summarised, Table
from hitchid.errors import InputError
from hitchid.handover.inverse import InverseTable, make_inverse_table
from hitchid.handover.responses import Banded, FrequencyResponse, checked_frequencies_hz, response_of
from hitchid.handover.speed import SteadySpeed, linear_channel, load_of_channel, speed_with_band
from hitchid.logs.record import COMMAND, DISPLACEMENT
from hitchid.model.inputs import Load, Numbers
from hitchid.model.parameter_draws import PARAMETER_DRAWS, draws_of
from hitchid.structures import (
    LinearModel,
    SmallSignal,
    default_command,
    default_displacement,
    small_signal_at,
    small_signals,
)

if TYPE_CHECKING:
    import control
    from scipy import signal

    from hitchid.model.hitch import Hitch


INSTEAD = "`simulate` for a record, or `step` in a loop"


@dataclass(frozen=True, eq=False, repr=False)
class Linearisation(Summarised):
    """Linear model from a change of the command to that of the displacement about an operating point.

    Y(s) = ± k x₁ᵀ (s − A)⁻¹ B exp(−s T)/(1 + s τ) U(s); see `hitchid.structures.linearise`.

    Attributes:
        direction: of the channel.
        command, displacement: of the operating point, in `units`.
        load: covariates of the operating point, by name.
        units: role to unit.
        step_s: sampling time of the hitch model, s.
        small_signal: with the model's parameters.
        drawn: with parameter vectors drawn from the distribution of the estimates, the first axis of all
            arrays; None without estimates.
        play: half width of the valve's hysteresis, in the command's unit.
        sign: −1 where the displacement falls with the command, else 1.
    """

    direction: str
    command: float
    displacement: float
    load: Mapping[str, float]
    units: Mapping[str, str]
    step_s: float
    small_signal: SmallSignal
    drawn: SmallSignal | None
    play: float
    sign: int

    def model(self, step_s: float | None = None) -> LinearModel:
        """Return the matrices of the linear model.

        Args:
            step_s: sampling time, s, for the exact model of a held command; None for the continuous model,
                the dead time as a Padé approximant of fourth order.

        Raises:
            InputError: the dead time has too many samples.
        """
        return self._signed(self.small_signal.state_space(step_s))

    def models(self, step_s: float | None = None) -> tuple[LinearModel, ...]:
        """Return the matrices with each of the drawn parameter vectors; see `model`."""
        if self.drawn is None:
            return ()
        draws = (SmallSignal(*arrays) for arrays in zip(*self.drawn, strict=True))
        return tuple(self._signed(draw.state_space(step_s)) for draw in draws)

    def to_scipy(self, step_s: float | None = None) -> "signal.StateSpace":
        """Return the linear model as `scipy.signal` has it; see `model`."""
        return self.model(step_s).to_scipy()

    def to_control(self, step_s: float | None = None) -> "control.StateSpace":
        """Return the linear model as python-control has it; see `model`."""
        return self.model(step_s).to_control()

    @property
    def gain(self) -> Banded:
        """Change of the steady speed over that of the command, with its 95 % band.

        Positive where the displacement grows with the command; zero without an integrator.
        """
        drawn = None if self.drawn is None else _speed_gain(self.drawn, self.sign)
        return Banded.of(_speed_gain(self.small_signal, self.sign), drawn)

    @property
    def dead_time_s(self) -> Banded:
        """Dead time, s, with its 95 % band."""
        drawn = None if self.drawn is None else np.asarray(self.drawn.dead_time_s)
        return Banded.of(np.asarray(self.small_signal.dead_time_s), drawn)

    def frequency_response(
        self, frequency_hz: Float[np.ndarray, " f"] | None = None, *, amplitude: float | None = None
    ) -> FrequencyResponse:
        """Return the response from command to travel over frequency, with its 95 % band.

        Args:
            frequency_hz: Hz, shape [F]; by default three decades up to half the sampling frequency.
            amplitude: of a sine of the command about the operating point, in its unit: the response is
                multiplied by the describing function of the play, which vanishes where the amplitude is not
                above its half width. None for changes that continue in one sense, with the play passed.

        Raises:
            InputError: a frequency or the amplitude is not positive.
        """
        frequencies = checked_frequencies_hz(frequency_hz, self.step_s)
        response = response_of(self.small_signal, self.drawn, frequencies)
        if amplitude is None:
            return response
        factor = describing_function(self.play, checks.number(amplitude, "amplitude", above=0.0))
        phase_rad = float(np.angle(factor))
        return FrequencyResponse(
            frequencies,
            response.magnitude.map(lambda rows: abs(factor) * rows),
            response.phase_rad.map(lambda rows: rows + phase_rad),
        )

    def _signed(self, model: LinearModel) -> LinearModel:
        return LinearModel(model.a, model.b, self.sign * model.c, model.step_s)

    def _summary(self) -> Table:
        unit, command_unit = self.units[DISPLACEMENT], self.units[COMMAND[self.direction]]
        load = "".join(
            f", {name} {value:.4g} {self.units.get(name, '')}" for name, value in self.load.items()
        )
        rows = (
            ("change of speed over command", *_cells(self.gain, f"{unit}/(s·{command_unit})")),
            ("dead time", *_cells(self.dead_time_s, "s")),
            ("half width of the play", f"{self.play:.4g} {command_unit}", ""),
        )
        title = (
            f"Linear model of {self.direction} at {self.command:.4g} {command_unit}, "
            f"{self.displacement:.4g} {unit}{load}"
        )
        return Table(title, ("quantity", "value", "95 %"), rows)


@double_precision
def linearise_hitch(
    model: "Hitch",
    direction: str | None,
    *,
    command: float | None,
    displacement: float | None,
    load: Load | None,
    draws: int,
    seed: int,
) -> Linearisation:
    """Return the linear model about an operating point; see `Hitch.linearise`."""
    channel = linear_channel(model, direction, instead=INSTEAD)
    row = load_of_channel(channel, load)
    if row.ndim > 1:
        raise checks.input_error("load", "one load", load)
    at_load, benchmark = jnp.asarray(row), channel.benchmark
    effective, position = None, None
    if command is not None:
        effective = abs(checks.number(command, "command")) - channel.dead_zone
        if not effective > 0:
            raise InputError(
                f"command: expected one beyond the dead zone of {channel.dead_zone:.4g}, got {command}"
            )
    if displacement is not None:
        position = checks.number(displacement, "displacement")
    here = benchmark.at_load(at_load)
    nominal = small_signal_at(here, effective, position)
    point = (
        default_command(here) if effective is None else jnp.asarray(effective),
        default_displacement(here) if position is None else jnp.asarray(position),
    )
    # The draws are linearised at the same point, so that they differ by their parameters alone.
    vectors, drawn = draws_of(model, channel.direction, seed, draws) if draws else None, None
    if vectors is not None:
        linear_models = small_signals(benchmark, jnp.asarray(vectors), at_load, *point)
        drawn = jax.tree.map(np.asarray, linear_models)
    nonlinearity = benchmark.nonlinearity
    hysteresis = 0.0 if nonlinearity is None else float(nonlinearity.named("hysteresis")[0])
    return Linearisation(
        direction=channel.direction,
        command=channel.dead_zone + float(point[0]),
        displacement=float(point[1]),
        load=dict(zip(benchmark.covariates, row.tolist(), strict=False)),
        units=model.units,
        step_s=model.step_s,
        small_signal=jax.tree.map(np.asarray, nominal),
        drawn=drawn,
        play=0.5 * hysteresis * channel.dead_zone,
        sign=channel.sign,
    )


def describing_function(play: float, amplitude: float) -> complex:
    """Return the ratio of the fundamental of a play's output to its input, a sine.

    With κ = 1 − 2 δ/A: (π/2 + asin κ + κ √(1 − κ²) − j (1 − κ²))/π; zero where A ≤ δ (Gelb & Vander Velde
    1968, Multiple-Input Describing Functions, sec. 2.3).

    Args:
        play: half width δ, in the unit of the amplitude.
        amplitude: of the sine, A.
    """
    if amplitude <= play:
        return 0j
    kappa = 1 - 2 * play / amplitude
    real = np.pi / 2 + np.arcsin(kappa) + kappa * np.sqrt(1 - kappa**2)
    return complex(real, -(1 - kappa**2)) / np.pi


def _speed_gain(linear: SmallSignal, sign: int) -> Float[np.ndarray, "*s"]:
    """Return ± lim s G(s) for s to 0: the steady speed, at which all states but the first stay."""
    a, b = np.asarray(linear.a), np.asarray(linear.b)
    steady = -np.linalg.solve(a[..., 1:, 1:], b[..., 1:, None])
    speed = b[..., 0] + (a[..., :1, 1:] @ steady)[..., 0, 0]
    integrates = np.all(a[..., 0] == 0, axis=-1)
    return np.asarray(sign * np.asarray(linear.gain) * np.where(integrates, speed, 0.0))


def _cells(quantity: Banded, unit: str) -> tuple[str, str]:
    value = f"{float(quantity.value):.4g} {unit}"
    if quantity.lower is None or quantity.upper is None:
        return value, ""
    return value, f"{float(quantity.lower):.4g} … {float(quantity.upper):.4g}"


# What a controller takes from a model: steady speeds, their inverse, linear models.


class Handover:
    """The part of `Hitch` that a controller is designed from."""

    @named_arguments
    def speed(
        self,
        command: Numbers,
        direction: str | None = None,
        *,
        displacement: Numbers | None = None,
        load: Load | None = None,
    ) -> SteadySpeed:
        """Return the steady speed at constant command, with its 95 % band: K w(c − d₀) g(x).

        That of a structure without an integrator is its speed at the start. Arrays broadcast.

        Args:
            command: as logged, in the model's unit.
            direction: of the channel; may be omitted in a model of one channel.
            displacement: where the piston is, in the model's unit; by default mid stroke.
            load: covariate before motion, in the model's unit, or several by name; by default the means of
                the tests.

        Raises:
            InputError: the structure has no speed map, or an argument does not fit.
        """
        return speed_with_band(_hitch(self), command, direction, displacement=displacement, load=load)

    @named_arguments
    def inverse_table(
        self,
        direction: str | None = None,
        speeds: Numbers | None = None,
        *,
        displacement: float | None = None,
        load: Load | None = None,
    ) -> InverseTable:
        """Return the command for each steady speed, the inverse of `speed`, as a table for a controller.

        Args:
            direction, displacement, load: as in `speed`.
            speeds: positive where the displacement grows; by default 33 from zero to the speed at the largest
                command of the tests.

        Raises:
            InputError: as `speed`, a speed cannot be reached, or the speed does not rise with the command.
        """
        return make_inverse_table(_hitch(self), direction, speeds, displacement=displacement, load=load)

    @named_arguments
    def linearise(
        self,
        direction: str | None = None,
        *,
        command: float | None = None,
        displacement: float | None = None,
        load: Load | None = None,
        draws: int = PARAMETER_DRAWS,
        seed: int = 0,
    ) -> Linearisation:
        """Return the linear model of a direction about an operating point, with draws of its parameters.

        From the deviation of the command to that of the displacement, without compensators; its parameters
        are also drawn from the distribution of their estimates, at a fixed dead zone, for bands and for a
        design that holds for all of them. The default operating point has the parameters of the identified
        transfer function; others are a list comprehension away.

        Args:
            direction: of the channel; may be omitted in a model of one channel.
            command, displacement, load: operating point, in the model's units; by default half way from
                the opening of the valve to the largest command, mid stroke, and mean load of the tests.
            draws: number of parameter vectors; a model without standard errors has none.
            seed: of the draws.

        Raises:
            InputError: the structure is not linear, the valve is closed at the operating point, or an
                argument does not fit.
        """
        point = {"command": command, "displacement": displacement, "load": load}
        return linearise_hitch(_hitch(self), direction, **point, draws=draws, seed=seed)

    @named_arguments
    def to_scipy(
        self,
        direction: str | None = None,
        step_s: float | None = None,
        *,
        command: float | None = None,
        displacement: float | None = None,
        load: Load | None = None,
    ) -> "signal.StateSpace":
        """Return the linear state-space model of a direction as `scipy.signal` has it; see `to_control`."""
        point = {"command": command, "displacement": displacement, "load": load}
        return self.linearise(direction, **point, draws=0).to_scipy(step_s)

    @named_arguments
    def to_control(
        self,
        direction: str | None = None,
        step_s: float | None = None,
        *,
        command: float | None = None,
        displacement: float | None = None,
        load: Load | None = None,
    ) -> "control.StateSpace":
        """Return the linear state-space model of a direction as python-control has it, without compensators.

        From the deviation of the command to that of the displacement, about an operating point. Without
        nonlinearities of valve and stroke it is exact beyond the dead zone, also from rest, for the command
        minus the dead zone. Otherwise its gain is that at the operating point; see
        `hitchid.structures.linearise`.

        Args:
            direction: of the channel; may be omitted in a model of one channel.
            step_s: sampling time, s, for the exact model of a held command; None for the continuous model,
                the dead time as a Padé approximant of fourth order.
            command, displacement, load: operating point, in the model's units; by default half way from
                the opening of the valve to the largest command, mid stroke, and mean load of the tests.

        Raises:
            InputError: the structure is not linear, the valve is closed at the operating point, the dead time
                has too many samples, or python-control is not installed.
        """
        point = {"command": command, "displacement": displacement, "load": load}
        return self.linearise(direction, **point, draws=0).to_control(step_s)


def _hitch(handover: Handover) -> "Hitch":
    """Return the model itself: `Hitch` is the only class with this part."""
    return cast("Hitch", handover)
