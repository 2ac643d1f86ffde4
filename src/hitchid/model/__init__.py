"""The identified plant: channels, the hitch they make up, and its folder on disk."""

from hitchid.model.artifact import load as load
from hitchid.model.artifact import load_trace as load_trace
from hitchid.model.artifact import save as save
from hitchid.model.channel import Channel as Channel
from hitchid.model.channel import remove_padding as remove_padding
from hitchid.model.dynamics import HitchState as HitchState
from hitchid.model.hitch import Band as Band
from hitchid.model.hitch import Hitch as Hitch
from hitchid.model.limits import TravelLimits as TravelLimits
from hitchid.model.packing import Packed as Packed
from hitchid.model.provenance import Provenance as Provenance
from hitchid.model.provenance import TwoModes as TwoModes
from hitchid.model.runs import FreeRun as FreeRun
