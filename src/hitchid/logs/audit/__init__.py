"""Audit of logs before an identification: faults that would bias a model, their place and remedy."""

from hitchid._support.records import Severity as Severity
from hitchid.logs.audit.audit import audit as audit
from hitchid.logs.audit.command_checks import CommandResponse as CommandResponse
from hitchid.logs.audit.command_checks import rest_level as rest_level
from hitchid.logs.audit.context import AuditFinding as AuditFinding
from hitchid.logs.audit.context import Quality as Quality
from hitchid.logs.audit.context import campaign_context as campaign_context
from hitchid.logs.audit.context import quality as quality
from hitchid.logs.audit.end_stops import find_end_stop as find_end_stop
from hitchid.logs.audit.end_stops import find_end_stops as find_end_stops
from hitchid.logs.audit.feedback import Feedback as Feedback
from hitchid.logs.audit.feedback import feedback_of as feedback_of
from hitchid.logs.audit.resolution import update_interval as update_interval
