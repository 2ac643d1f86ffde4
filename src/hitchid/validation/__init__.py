"""Validation: `validate` compares a model with tests that its identification did not use."""

from hitchid._support.tables import DataTable as DataTable
from hitchid.validation.acceptance import Acceptance as Acceptance
from hitchid.validation.acceptance import Check as Check
from hitchid.validation.acceptance import check_limits as check_limits
from hitchid.validation.comparison import ModelComparison as ModelComparison
from hitchid.validation.comparison import compare as compare
from hitchid.validation.leaderboard import Leaderboard as Leaderboard
from hitchid.validation.leaderboard import LeaderboardRow as LeaderboardRow
from hitchid.validation.leaderboard import Standing as Standing
from hitchid.validation.limits import read_limits as read_limits
from hitchid.validation.report_data import ReportData as ReportData
from hitchid.validation.results import CYCLES as CYCLES
from hitchid.validation.results import NAMES as NAMES
from hitchid.validation.results import Accuracy as Accuracy
from hitchid.validation.results import BandFigures as BandFigures
from hitchid.validation.results import ChannelResult as ChannelResult
from hitchid.validation.results import CycleResult as CycleResult
from hitchid.validation.results import Horizons as Horizons
from hitchid.validation.results import ModelFigures as ModelFigures
from hitchid.validation.results import Predictions as Predictions
from hitchid.validation.results import RunFigures as RunFigures
from hitchid.validation.validate import validate as validate
from hitchid.validation.validation import Validation as Validation
