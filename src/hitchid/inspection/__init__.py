"""Inspection of logs before an identification, and proposal of a first `campaign.toml`."""

from hitchid.inspection.inspect_logs import inspect as inspect
from hitchid.inspection.inspect_logs import inspect_campaign as inspect_campaign
from hitchid.inspection.propose import propose as propose
from hitchid.inspection.results import InspectedRecord as InspectedRecord
from hitchid.inspection.results import Inspection as Inspection
