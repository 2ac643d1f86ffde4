"""Adaptation of a model to a machine that changes: from each stroke, bounded, proved, with a way back."""

from hitchid.live.adaptation_process import OnlineAdaptation as OnlineAdaptation
from hitchid.live.adapter import Adaptation as Adaptation
from hitchid.live.adapter import Adapter as Adapter
from hitchid.live.adapter import AdapterState as AdapterState
from hitchid.live.adapter import adapt as adapt
from hitchid.live.change_log import ChangeLog as ChangeLog
from hitchid.live.change_log import Trend as Trend
from hitchid.live.change_log import read_events as read_events
from hitchid.live.change_log import trends as trends
from hitchid.live.events import REPORTED as REPORTED
from hitchid.live.events import Event as Event
from hitchid.live.live import Live as Live
from hitchid.live.live import Output as Output
from hitchid.live.monitor import Monitor as Monitor
from hitchid.live.monitor import Predictions as Predictions
from hitchid.live.parameters import Changes as Changes
from hitchid.live.parameters import changed_model as changed_model
from hitchid.live.settings import AdaptationSettings as AdaptationSettings
from hitchid.live.strokes import Stroke as Stroke
from hitchid.live.strokes import StrokeCutter as StrokeCutter
