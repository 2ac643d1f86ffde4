"""What a control engineer takes from a model: steady speed, its inverse, linear models, responses."""

# A model hands itself over, so the two rooms import each other: the model must come first.
import hitchid.model  # noqa: F401
from hitchid.handover.inverse import InverseTable as InverseTable
from hitchid.handover.responses import FrequencyResponse as FrequencyResponse
from hitchid.handover.responses import StepResponse as StepResponse
from hitchid.handover.responses import frequency_response as frequency_response
from hitchid.handover.responses import step_responses as step_responses
from hitchid.handover.speed import SteadySpeed as SteadySpeed
