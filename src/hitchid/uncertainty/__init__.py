"""Uncertainty: how well tests determine parameters, and what they leave open."""

from hitchid.uncertainty.assess import KNOWN as KNOWN
from hitchid.uncertainty.assess import DeadZoneError as DeadZoneError
from hitchid.uncertainty.assess import assess as assess
from hitchid.uncertainty.estimate import Estimate as Estimate
from hitchid.uncertainty.estimate import Interval as Interval
from hitchid.uncertainty.estimate import Quantity as Quantity
from hitchid.uncertainty.estimate import Uncertainty as Uncertainty
