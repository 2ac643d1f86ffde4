"""Estimates: how well tests determine parameters, and what they leave open."""

from hitchid.uncertainty.assess import assess as assess
from hitchid.uncertainty.assess import unassessed as unassessed
from hitchid.uncertainty.bands import Bands as Bands
from hitchid.uncertainty.bands import EnsembleMember as EnsembleMember
from hitchid.uncertainty.characteristics import Characteristics as Characteristics
from hitchid.uncertainty.characteristics import MeasuredSpeed as MeasuredSpeed
from hitchid.uncertainty.characteristics import SpeedPoint as SpeedPoint
from hitchid.uncertainty.characteristics import make_quantity as make_quantity
from hitchid.uncertainty.dead_zone_error import NO_ERROR as NO_ERROR
from hitchid.uncertainty.dead_zone_error import DeadZoneError as DeadZoneError
from hitchid.uncertainty.estimate import Estimate as Estimate
from hitchid.uncertainty.estimate import Estimates as Estimates
from hitchid.uncertainty.estimate import Interval as Interval
from hitchid.uncertainty.estimate import Quantity as Quantity
from hitchid.uncertainty.influence import Influence as Influence
from hitchid.uncertainty.information import Information as Information
from hitchid.uncertainty.speed_map import characteristics as characteristics
from hitchid.uncertainty.uncertainty import Uncertainty as Uncertainty
