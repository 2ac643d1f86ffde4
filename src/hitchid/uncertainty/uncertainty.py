"""Everything that is known of how far one channel can be trusted, as one frozen record."""

from dataclasses import asdict, dataclass

from pydantic import TypeAdapter

from hitchid.estimation import SearchHistory
from hitchid.uncertainty.bands import Bands
from hitchid.uncertainty.characteristics import Characteristics
from hitchid.uncertainty.estimate import Estimates
from hitchid.uncertainty.information import Information


@dataclass(frozen=True)
class Uncertainty:
    """How far one channel can be trusted.

    Attributes:
        benchmark: what is known of its parameters.
        paper: the same of the transfer function of Sun et al. 2025, fitted to the same tests; None where it
            was not, or where the channel is that.
        bands: around its predictions; None where there were too few tests.
        searches: how several searches for its parameters went, from several seeds each; empty where they
            were not compared.
        searched: what they searched: the form's parameters, by name.
        information: what the tests say of the parameters together, for the design of the next one.
        characteristics: speed map, dead zone, delay and response time; None where the form has no steady
            speed, where they could not be found, or in a model of an older version.
    """

    benchmark: Estimates
    paper: Estimates | None = None
    bands: Bands | None = None
    searches: tuple[SearchHistory, ...] = ()
    searched: tuple[str, ...] = ()
    information: Information | None = None
    characteristics: Characteristics | None = None

    def describe(self) -> dict:
        """Return it as JSON can hold it."""
        return asdict(self)

    @classmethod
    def of(cls, description: dict) -> "Uncertainty":
        """Return what was described.

        Raises:
            ValueError: the description is not one of this version.
        """
        return _ADAPTER.validate_python(description)


_ADAPTER = TypeAdapter(Uncertainty)
