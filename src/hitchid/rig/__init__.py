"""Virtual test bench: simulator of a tractor's electro-hydraulic hitch, the ground truth for models."""

from hitchid.rig.measurement import measure as measure
from hitchid.rig.pacing import real_time as real_time
from hitchid.rig.parameter_files import load_rig as load_rig
from hitchid.rig.parameter_files import parameter_sets as parameter_sets
from hitchid.rig.simulation import RigMotion as RigMotion
from hitchid.rig.simulation import simulate as simulate
from hitchid.rig.small_signal import OperatingPoint as OperatingPoint
from hitchid.rig.small_signal import SmallSignal as SmallSignal
from hitchid.rig.small_signal import lowering_small_signal as lowering_small_signal
from hitchid.rig.small_signal import small_signal as small_signal
from hitchid.rig.stepping import BenchState as BenchState
from hitchid.rig.stepping import Disturbance as Disturbance
from hitchid.rig.stepping import Measurement as Measurement
from hitchid.rig.stepping import reset as reset
from hitchid.rig.stepping import step as step
from hitchid.rig.test_bench import Rig as Rig
from hitchid.rig.test_bench import RigLimits as RigLimits
from hitchid.rig.test_bench import rig_limits as rig_limits

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
