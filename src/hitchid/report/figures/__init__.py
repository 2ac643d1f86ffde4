"""Figures: functions of a result that return pictures with their data, in one style."""

from hitchid.report.figures.errors import coverage as coverage
from hitchid.report.figures.errors import error_distribution as error_distribution
from hitchid.report.figures.errors import errors_by_test as errors_by_test
from hitchid.report.figures.errors import horizons as horizons
from hitchid.report.figures.errors import outputs as outputs
from hitchid.report.figures.errors import predicted_errors as predicted_errors
from hitchid.report.figures.errors import residual_correlations as residual_correlations
from hitchid.report.figures.errors import residuals_by_variable as residuals_by_variable
from hitchid.report.figures.identification import convergence as convergence
from hitchid.report.figures.identification import dead_zone as dead_zone
from hitchid.report.figures.identification import intervals as intervals
from hitchid.report.figures.identification import loads as loads
from hitchid.report.figures.identification import losses as losses
from hitchid.report.figures.identification import searches as searches
from hitchid.report.figures.identification import speed_map as speed_map
from hitchid.report.figures.identification import structures as structures
from hitchid.report.figures.identification import valve_map as valve_map
from hitchid.report.figures.timeline import timeline as timeline
from hitchid.report.figures.timeline import timeline_picture as timeline_picture
