"""The virtual test bench: a tractor's electro-hydraulic hitch as physics, the truth for models."""

from hitchid.rig.bench import Limits as Limits
from hitchid.rig.bench import Rig as Rig
from hitchid.rig.bench import limits as limits
from hitchid.rig.measurement import measure as measure
from hitchid.rig.parameter_files import load_rig as load_rig
from hitchid.rig.parameter_files import parameter_sets as parameter_sets
from hitchid.rig.simulation import Motion as Motion
from hitchid.rig.simulation import simulate as simulate
from hitchid.rig.small_signal import OperatingPoint as OperatingPoint
from hitchid.rig.small_signal import SmallSignal as SmallSignal
from hitchid.rig.small_signal import lowering_small_signal as lowering_small_signal
from hitchid.rig.small_signal import small_signal as small_signal

__all__ = [
    "Limits",
    "Motion",
    "OperatingPoint",
    "Rig",
    "SmallSignal",
    "limits",
    "load_rig",
    "lowering_small_signal",
    "measure",
    "parameter_sets",
    "simulate",
    "small_signal",
]
