"""Uncertainty of the estimates: standard errors, confidence intervals, profiles, prediction bands."""

from hitchid.uncertainty.influence import Influence as Influence
from hitchid.uncertainty.influence import information_of as information_of
from hitchid.uncertainty.influence import profile_out_gain as profile_out_gain
from hitchid.uncertainty.influence import standard_errors as standard_errors
from hitchid.uncertainty.influence import standard_errors_with as standard_errors_with
from hitchid.uncertainty.influence import standard_errors_with_repeat as standard_errors_with_repeat
from hitchid.uncertainty.intervals import assess as assess
from hitchid.uncertainty.intervals import unassessed as unassessed
from hitchid.uncertainty.load_scatter import load_scatter as load_scatter
from hitchid.uncertainty.scores import NO_ERROR as NO_ERROR
from hitchid.uncertainty.scores import DeadZoneError as DeadZoneError
from hitchid.uncertainty.scores import difference_test as difference_test
from hitchid.uncertainty.speed_map import characteristics as characteristics
