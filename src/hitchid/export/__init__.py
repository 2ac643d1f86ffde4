"""Export of models to where they are used: C99, MATLAB, FMU, ONNX, each proved against the model."""

from hitchid.export.c99 import Export as Export
from hitchid.export.c99 import to_c as to_c
from hitchid.export.c_templates import Precision as Precision
from hitchid.export.fmu import to_fmu as to_fmu
from hitchid.export.matlab import to_matlab as to_matlab
from hitchid.export.onnx_network import to_onnx as to_onnx
from hitchid.export.verification import Parity as Parity
from hitchid.export.verification import ParityError as ParityError
