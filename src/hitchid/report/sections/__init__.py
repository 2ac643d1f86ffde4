"""Sections of a report, each a function of a result."""

from hitchid.report.sections.acceptance import limits as limits
from hitchid.report.sections.cycles import cycles as cycles
from hitchid.report.sections.direction import DirectionContext as DirectionContext
from hitchid.report.sections.direction import accuracy as accuracy
from hitchid.report.sections.direction import errors as errors
from hitchid.report.sections.direction import parameters as parameters
from hitchid.report.sections.direction import search as search
from hitchid.report.sections.direction import shown_tests as shown_tests
from hitchid.report.sections.direction import trust as trust
from hitchid.report.sections.logs import logs as logs
from hitchid.report.sections.origin import origin as origin
from hitchid.report.sections.verdict import verdict as verdict
