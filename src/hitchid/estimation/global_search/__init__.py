"""Global searches of the unit cube: whale optimisation, differential evolution, multi-start."""

from hitchid.estimation.global_search.differential_evolution import (
    DifferentialEvolution as DifferentialEvolution,
)
from hitchid.estimation.global_search.multi_start import MultiStart as MultiStart
from hitchid.estimation.global_search.search import EVALUATIONS as EVALUATIONS
from hitchid.estimation.global_search.search import Search as Search
from hitchid.estimation.global_search.search import SearchResult as SearchResult
from hitchid.estimation.global_search.search import SearchStopReason as SearchStopReason
from hitchid.estimation.global_search.whale import WhaleConfig as WhaleConfig
from hitchid.estimation.global_search.whale_search import Whale as Whale
