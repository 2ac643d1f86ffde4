"""Physical models: structures in identifiable parameters, discretised exactly, simulated in batches."""

from hitchid.structures.batch import Batch as Batch
from hitchid.structures.batch import before_end_stop as before_end_stop
from hitchid.structures.batch import mean_before_motion as mean_before_motion
from hitchid.structures.batch import padded_length as padded_length
from hitchid.structures.discrete_physical_model import DiscretePhysicalModel as DiscretePhysicalModel
from hitchid.structures.discrete_physical_model import ValveState as ValveState
from hitchid.structures.discretisation import discretise as discretise
from hitchid.structures.discretisation import pulse_response as pulse_response
from hitchid.structures.model_spec import ModelSpec as ModelSpec
from hitchid.structures.nonlinear import NonlinearStructure as NonlinearStructure
from hitchid.structures.physical_model import PhysicalModel as PhysicalModel
from hitchid.structures.registry import BUILT_IN as BUILT_IN
from hitchid.structures.registry import external_structures as external_structures
from hitchid.structures.registry import registered_structures as registered_structures
from hitchid.structures.registry import structure_named as structure_named
from hitchid.structures.static_nonlinearity import NONLINEARITY_PARAMETERS as NONLINEARITY_PARAMETERS
from hitchid.structures.static_nonlinearity import Scales as Scales
from hitchid.structures.static_nonlinearity import StaticNonlinearity as StaticNonlinearity
from hitchid.structures.structure import DEAD_TIME as DEAD_TIME
from hitchid.structures.structure import LinearStructure as LinearStructure
from hitchid.structures.structure import ModelOption as ModelOption
from hitchid.structures.structure import Parameter as Parameter
from hitchid.structures.structure import Scale as Scale
from hitchid.structures.structure import Structure as Structure
