"""Reports: what a result means, with its figures, as a page that people read."""

from hitchid.report.comparison_report import comparison_report as comparison_report
from hitchid.report.document import Document as Document
from hitchid.report.document import Finding as Finding
from hitchid.report.document import Picture as Picture
from hitchid.report.document import Pictures as Pictures
from hitchid.report.document import Rating as Rating
from hitchid.report.document import ReportSection as ReportSection
from hitchid.report.document import Text as Text
from hitchid.report.document import sentence as sentence
from hitchid.report.pdf import check_pdf as check_pdf
from hitchid.report.validation_report import direction_sections as direction_sections
from hitchid.report.validation_report import validation_report as validation_report
from hitchid.report.write import FIGURES as FIGURES
from hitchid.report.write import write_report as write_report
from hitchid.report.write import write_report_files as write_report_files
