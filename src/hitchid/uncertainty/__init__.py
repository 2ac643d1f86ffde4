"""Uncertainty of the estimates: standard errors, confidence intervals, profiles, prediction bands."""

from hitchid.uncertainty.assess import assess as assess
from hitchid.uncertainty.assess import unassessed as unassessed
from hitchid.uncertainty.dead_zone_error import NO_ERROR as NO_ERROR
from hitchid.uncertainty.dead_zone_error import DeadZoneError as DeadZoneError
from hitchid.uncertainty.difference import difference_test as difference_test
from hitchid.uncertainty.influence import Influence as Influence
from hitchid.uncertainty.information import information_of as information_of
from hitchid.uncertainty.load_scatter import load_scatter as load_scatter
from hitchid.uncertainty.speed_map import characteristics as characteristics
