"""Record of the uncertainty of one channel: parameters, bands, operating characteristics."""

from dataclasses import dataclass

from hitchid._support.short_repr import short_repr
from hitchid.model.bands import Bands
from hitchid.model.characteristics import Characteristics
from hitchid.model.estimates import Estimates
from hitchid.model.information import Information
from hitchid.model.load_scatter import LoadScatter


@short_repr
@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of one channel.

    Attributes:
        benchmark: estimates of the benchmark's parameters.
        bands: bands around the predictions; None where there were too few tests.
        information: Fisher information of the tests, for the design of the next one.
        characteristics: speed map, dead zone, delay and response time; None where the structure has no steady
            speed, or where they could not be computed.
        load_scatter: scatter of the speed between tests; None where it could not be computed.
    """

    benchmark: Estimates
    bands: Bands | None = None
    information: Information | None = None
    characteristics: Characteristics | None = None
    load_scatter: LoadScatter | None = None
