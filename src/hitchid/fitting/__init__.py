"""Fitting: the misfit of a form over tests, global searches of it, and the least-squares polish."""

from hitchid.fitting.misfit import Misfit as Misfit
from hitchid.fitting.misfit import free_speeds as free_speeds
from hitchid.fitting.misfit import polish_some as polish_some
from hitchid.fitting.search import DifferentialEvolution as DifferentialEvolution
from hitchid.fitting.search import Found as Found
from hitchid.fitting.search import MultiStart as MultiStart
from hitchid.fitting.search import Polished as Polished
from hitchid.fitting.search import Problem as Problem
from hitchid.fitting.search import Search as Search
from hitchid.fitting.search import Whale as Whale
from hitchid.fitting.search import best_polished as best_polished
from hitchid.fitting.search import polish as polish
from hitchid.fitting.searchable import searchable as searchable
from hitchid.fitting.trail import Comparison as Comparison
from hitchid.fitting.trail import Run as Run
from hitchid.fitting.trail import Trail as Trail
from hitchid.fitting.trail import search_trails as search_trails
