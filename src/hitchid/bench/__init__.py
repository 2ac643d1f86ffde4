"""Virtual test bench: simulator of a tractor's electro-hydraulic hitch, the ground truth for models."""

from hitchid.bench.measurement import measure as measure
from hitchid.bench.parameter_files import load_rig as load_rig
from hitchid.bench.parameter_files import parameter_sets as parameter_sets
from hitchid.bench.plant import Rig as Rig
from hitchid.bench.plant import RigLimits as RigLimits
from hitchid.bench.plant import rig_limits as rig_limits
from hitchid.bench.simulation import RigMotion as RigMotion
from hitchid.bench.simulation import simulate as simulate
from hitchid.bench.small_signal import OperatingPoint as OperatingPoint
from hitchid.bench.small_signal import SmallSignal as SmallSignal
from hitchid.bench.small_signal import lowering_small_signal as lowering_small_signal
from hitchid.bench.small_signal import small_signal as small_signal
from hitchid.bench.stepping import BenchState as BenchState
from hitchid.bench.stepping import Disturbance as Disturbance
from hitchid.bench.stepping import Measurement as Measurement
from hitchid.bench.stepping import real_time as real_time
from hitchid.bench.stepping import reset as reset
from hitchid.bench.stepping import step as step

__all__ = [
    "BenchState",
    "Disturbance",
    "Measurement",
    "OperatingPoint",
    "Rig",
    "RigLimits",
    "RigMotion",
    "SmallSignal",
    "load_rig",
    "lowering_small_signal",
    "measure",
    "parameter_sets",
    "real_time",
    "reset",
    "rig_limits",
    "simulate",
    "small_signal",
    "step",
]
