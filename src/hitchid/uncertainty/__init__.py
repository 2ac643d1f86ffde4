"""Estimates: how well tests determine parameters, and what they leave open."""

from hitchid.uncertainty.assess import assess as assess
from hitchid.uncertainty.assess import unassessed as unassessed
from hitchid.uncertainty.bands import Alternative as Alternative
from hitchid.uncertainty.bands import Bands as Bands
from hitchid.uncertainty.dead_zone_error import KNOWN as KNOWN
from hitchid.uncertainty.dead_zone_error import DeadZoneError as DeadZoneError
from hitchid.uncertainty.estimate import Estimate as Estimate
from hitchid.uncertainty.estimate import Estimates as Estimates
from hitchid.uncertainty.estimate import Interval as Interval
from hitchid.uncertainty.estimate import Quantity as Quantity
from hitchid.uncertainty.information import Information as Information
from hitchid.uncertainty.moves import Moves as Moves
from hitchid.uncertainty.uncertainty import Uncertainty as Uncertainty
from hitchid.uncertainty.words import interval_text as interval_text
from hitchid.uncertainty.words import stated as stated
