"""Validation: `validate` compares a model with tests it has not seen."""

from hitchid.validation.acceptance import Acceptance as Acceptance
from hitchid.validation.acceptance import check_limits as check_limits
from hitchid.validation.acceptance import line as line
from hitchid.validation.comparison import ModelComparison as ModelComparison
from hitchid.validation.comparison import compare as compare
from hitchid.validation.junit import junit_xml as junit_xml
from hitchid.validation.limits import CYCLES as CYCLES
from hitchid.validation.limits import read_limits as read_limits
from hitchid.validation.predictions import Predictions as Predictions
from hitchid.validation.table import Table as Table
from hitchid.validation.table import error_cells as error_cells
from hitchid.validation.table import numeric as numeric
from hitchid.validation.table import rounded as rounded
from hitchid.validation.tables import NAMES as NAMES
from hitchid.validation.tables import markdown as markdown
from hitchid.validation.tables import tables as tables
from hitchid.validation.validate import Validation as Validation
from hitchid.validation.validate import validate as validate
