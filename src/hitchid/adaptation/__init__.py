"""Adaptation of a model to a machine that changes: from each stroke, bounded, proved, with a way back."""

from hitchid.adaptation.adapter import Adapter as Adapter
from hitchid.adaptation.adapter import AdapterState as AdapterState
from hitchid.adaptation.events import REPORTED as REPORTED
from hitchid.adaptation.events import Event as Event
from hitchid.adaptation.log_file import read_events as read_events
from hitchid.adaptation.parameters import Changes as Changes
from hitchid.adaptation.parameters import changed_model as changed_model
from hitchid.adaptation.replay import Adaptation as Adaptation
from hitchid.adaptation.replay import adapt as adapt
from hitchid.adaptation.settings import AdaptationSettings as AdaptationSettings
from hitchid.adaptation.strokes import Stroke as Stroke
from hitchid.adaptation.strokes import StrokeCutter as StrokeCutter
from hitchid.adaptation.trends import Trend as Trend
from hitchid.adaptation.trends import trends as trends
