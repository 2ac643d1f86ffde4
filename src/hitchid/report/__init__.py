"""Reports: a document built from results, and the renderers of its file formats."""

from hitchid.report.comparison_report import comparison_report as comparison_report
from hitchid.report.comparison_report import comparison_tables as comparison_tables
from hitchid.report.document import Document as Document
from hitchid.report.document import Finding as Finding
from hitchid.report.document import Picture as Picture
from hitchid.report.document import Pictures as Pictures
from hitchid.report.document import Rating as Rating
from hitchid.report.document import ReportSection as ReportSection
from hitchid.report.document import Signals as Signals
from hitchid.report.document import Table as Table
from hitchid.report.document import Text as Text
from hitchid.report.document import sentence as sentence
from hitchid.report.renderers import Renderer as Renderer
from hitchid.report.renderers import check_renderers as check_renderers
from hitchid.report.renderers import registered_renderers as registered_renderers
from hitchid.report.renderers import render as render
from hitchid.report.trace_file import ChannelTraceFile as ChannelTraceFile
from hitchid.report.trace_file import read_trace as read_trace
from hitchid.report.validation_report import all_tables as all_tables
from hitchid.report.validation_report import direction_sections as direction_sections
from hitchid.report.validation_report import validation_report as validation_report
from hitchid.report.validation_report import validation_tables as validation_tables
from hitchid.report.write import FIGURES as FIGURES
from hitchid.report.write import Format as Format
from hitchid.report.write import write_report as write_report
from hitchid.report.write import write_report_files as write_report_files
