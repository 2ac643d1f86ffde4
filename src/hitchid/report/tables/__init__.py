"""Tables of a report, made from the records of a validation."""

from hitchid.report.tables.accuracy import accuracy_table as accuracy_table
from hitchid.report.tables.accuracy import cycle_tables as cycle_tables
from hitchid.report.tables.accuracy import horizon_table as horizon_table
from hitchid.report.tables.accuracy import single_test_table as single_test_table
from hitchid.report.tables.accuracy import summary_table as summary_table
from hitchid.report.tables.comparison import comparison_accuracy as comparison_accuracy
from hitchid.report.tables.comparison import comparison_horizons as comparison_horizons
from hitchid.report.tables.comparison import comparison_models as comparison_models
from hitchid.report.tables.comparison import comparison_parameters as comparison_parameters
from hitchid.report.tables.comparison import leaderboard_table as leaderboard_table
from hitchid.report.tables.parameters import characteristic_tables as characteristic_tables
from hitchid.report.tables.parameters import load_table as load_table
from hitchid.report.tables.parameters import parameter_table as parameter_table
from hitchid.report.tables.search import search_table as search_table
from hitchid.report.tables.trust import band_table as band_table
from hitchid.report.tables.trust import residual_table as residual_table
