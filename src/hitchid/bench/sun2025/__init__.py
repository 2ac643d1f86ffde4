"""Reproduction of Sun et al. 2025 on the virtual test bench."""

from hitchid.bench.sun2025.reproduce import Plan as Plan
from hitchid.bench.sun2025.reproduce import Study as Study
from hitchid.bench.sun2025.reproduce import quick_plan as quick_plan
from hitchid.bench.sun2025.reproduce import reproduce as reproduce
