"""Fitting: the misfit of a form over tests, global searches of it, and the least-squares polish."""

from hitchid.estimation.misfit import Misfit as Misfit
from hitchid.estimation.misfit import free_speeds as free_speeds
from hitchid.estimation.misfit import polish_some as polish_some
from hitchid.estimation.search import DifferentialEvolution as DifferentialEvolution
from hitchid.estimation.search import Found as Found
from hitchid.estimation.search import MultiStart as MultiStart
from hitchid.estimation.search import Polished as Polished
from hitchid.estimation.search import Problem as Problem
from hitchid.estimation.search import Search as Search
from hitchid.estimation.search import Whale as Whale
from hitchid.estimation.search import best_polished as best_polished
from hitchid.estimation.search import polish as polish
from hitchid.estimation.searchable import searchable as searchable
from hitchid.estimation.trail import Comparison as Comparison
from hitchid.estimation.trail import Run as Run
from hitchid.estimation.trail import Trail as Trail
from hitchid.estimation.trail import search_trails as search_trails
