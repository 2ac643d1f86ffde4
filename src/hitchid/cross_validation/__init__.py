"""Cross-validation: `cross_validate` identifies a campaign without each of its tests once."""

from hitchid.cross_validation.cross_validate import cross_validate as cross_validate
from hitchid.cross_validation.results import CrossValidation as CrossValidation
from hitchid.cross_validation.results import FoldResult as FoldResult
