"""What a controller takes from a model: steady speeds, their inverse, linear models."""

from typing import TYPE_CHECKING, cast

from hitchid._support.checks import named_arguments
from hitchid.model.commands import Numbers
from hitchid.model.inverse_table import InverseTable, make_inverse_table
from hitchid.model.linearisation import Linearisation, linearise_hitch
from hitchid.model.loads import Load
from hitchid.model.parameter_draws import DRAWS
from hitchid.model.speed import SteadySpeed, speed_with_band

if TYPE_CHECKING:
    import control
    from scipy import signal

    from hitchid.model.hitch import Hitch


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
        draws: int = DRAWS,
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
