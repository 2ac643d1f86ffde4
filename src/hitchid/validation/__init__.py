"""Validation: `validate` compares a model with tests it has not seen."""

from hitchid.validation.table import Table as Table
from hitchid.validation.tables import markdown as markdown
from hitchid.validation.tables import tables as tables
from hitchid.validation.validate import Validation as Validation
from hitchid.validation.validate import validate as validate
