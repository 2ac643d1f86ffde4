"""Benchmark models: linear structures in identifiable parameters, discretised exactly, run in batches."""

from hitchid.benchmark.batch import Batch as Batch
from hitchid.benchmark.batch import before_end_stop as before_end_stop
from hitchid.benchmark.batch import mean_before_motion as mean_before_motion
from hitchid.benchmark.batch import padded_length as padded_length
from hitchid.benchmark.benchmark import Benchmark as Benchmark
from hitchid.benchmark.discretise import discretise as discretise
from hitchid.benchmark.discretise import pulse_response as pulse_response
from hitchid.benchmark.form import Form as Form
from hitchid.benchmark.registry import STRUCTURES as STRUCTURES
from hitchid.benchmark.registry import structure_named as structure_named
from hitchid.benchmark.sampled import Sampled as Sampled
from hitchid.benchmark.sampled import Valve as Valve
from hitchid.benchmark.shape import SHAPE as SHAPE
from hitchid.benchmark.shape import Scales as Scales
from hitchid.benchmark.shape import Shape as Shape
from hitchid.benchmark.structure import DEAD_TIME as DEAD_TIME
from hitchid.benchmark.structure import Parameter as Parameter
from hitchid.benchmark.structure import Structure as Structure
