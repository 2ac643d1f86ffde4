"""Estimates: how well tests determine parameters, and what they leave open."""

from hitchid.uncertainty.assess import assess as assess
from hitchid.uncertainty.assess import unassessed as unassessed
from hitchid.uncertainty.dead_zone_error import NO_ERROR as NO_ERROR
from hitchid.uncertainty.dead_zone_error import DeadZoneError as DeadZoneError
from hitchid.uncertainty.formatting import format_interval as format_interval
from hitchid.uncertainty.formatting import format_with_error as format_with_error
from hitchid.uncertainty.influence import Influence as Influence
from hitchid.uncertainty.information import information_of as information_of
from hitchid.uncertainty.sentences import characteristic_sentences as characteristic_sentences
from hitchid.uncertainty.speed_map import characteristics as characteristics
