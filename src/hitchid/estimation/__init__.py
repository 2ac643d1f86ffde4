"""Fitting: the objective over tests, its global searches, and least squares."""

from hitchid.estimation.correlations import search_problem as search_problem
from hitchid.estimation.least_squares import LeastSquaresResult as LeastSquaresResult
from hitchid.estimation.least_squares import best_refined as best_refined
from hitchid.estimation.least_squares import refine as refine
from hitchid.estimation.objective import Objective as Objective
from hitchid.estimation.objective import allows_per_test_gain as allows_per_test_gain
from hitchid.estimation.objective import refine_subset as refine_subset
from hitchid.estimation.search_history import SearchComparison as SearchComparison
from hitchid.estimation.search_history import SearchHistory as SearchHistory
from hitchid.estimation.search_history import SearchRun as SearchRun
from hitchid.estimation.search_history import compare_searches as compare_searches
from hitchid.estimation.search_problem import SearchProblem as SearchProblem
from hitchid.estimation.searches import EVALUATIONS as EVALUATIONS
from hitchid.estimation.searches import DifferentialEvolution as DifferentialEvolution
from hitchid.estimation.searches import MultiStart as MultiStart
from hitchid.estimation.searches import Search as Search
from hitchid.estimation.searches import SearchResult as SearchResult
from hitchid.estimation.searches import SearchStopReason as SearchStopReason
from hitchid.estimation.whale import Whale as Whale
from hitchid.estimation.whale import WhaleConfig as WhaleConfig
