"""The study of Sun et al. 2025, redone on the virtual bench."""

from hitchid.study.reproduce import Plan as Plan
from hitchid.study.reproduce import Study as Study
from hitchid.study.reproduce import quick_plan as quick_plan
from hitchid.study.reproduce import reproduce as reproduce
