"""Audit of logs before an identification: faults that would bias a model, their place and remedy."""

from hitchid._support.notices import Severity as Severity
from hitchid.audit.audit import audit as audit
from hitchid.audit.context import campaign_context as campaign_context
from hitchid.audit.end_stops import find_end_stop as find_end_stop
from hitchid.audit.end_stops import find_end_stops as find_end_stops
from hitchid.audit.feedback import Feedback as Feedback
from hitchid.audit.feedback import feedback_of as feedback_of
from hitchid.audit.finding import AuditFinding as AuditFinding
from hitchid.audit.neutral import CommandResponse as CommandResponse
from hitchid.audit.neutral import rest_level as rest_level
from hitchid.audit.quality import Quality as Quality
from hitchid.audit.quality import quality as quality
from hitchid.audit.resolution import update_interval as update_interval
