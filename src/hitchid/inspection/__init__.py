"""A look at logs before any fit, and a first `campaign.toml` from them."""

from hitchid.inspection.inspect_logs import Inspection as Inspection
from hitchid.inspection.inspect_logs import inspect as inspect
from hitchid.inspection.inspect_logs import look_over as look_over
from hitchid.inspection.propose import propose as propose
