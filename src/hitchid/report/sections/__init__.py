"""Sections of a report, each a function of validation results."""

from hitchid.report.sections.acceptance import check_line as check_line
from hitchid.report.sections.acceptance import limits as limits
from hitchid.report.sections.accuracy import accuracy as accuracy
from hitchid.report.sections.accuracy import errors as errors
from hitchid.report.sections.context import DirectionContext as DirectionContext
from hitchid.report.sections.cycles import cycles as cycles
from hitchid.report.sections.logs import logs as logs
from hitchid.report.sections.origin import origin as origin
from hitchid.report.sections.overview import overview as overview
from hitchid.report.sections.parameters import parameters as parameters
from hitchid.report.sections.search import search as search
from hitchid.report.sections.trust import trust as trust
from hitchid.report.sections.verdict import uses as uses
from hitchid.report.sections.verdict import verdict as verdict
