"""Online use of a model on a running machine, sample by sample."""

from hitchid.online.adaptation import OnlineAdaptation as OnlineAdaptation
from hitchid.online.change_log import ChangeLog as ChangeLog
from hitchid.online.live import Live as Live
from hitchid.online.live import Output as Output
from hitchid.online.monitor import Monitor as Monitor
from hitchid.online.monitor import Predictions as Predictions
