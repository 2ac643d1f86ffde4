"""The study of Sun et al. 2025, redone on the virtual bench."""

from hitchid.studies.sun2025.reproduce import Plan as Plan
from hitchid.studies.sun2025.reproduce import Study as Study
from hitchid.studies.sun2025.reproduce import quick_plan as quick_plan
from hitchid.studies.sun2025.reproduce import reproduce as reproduce
