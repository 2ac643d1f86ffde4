"""Drawing into matplotlib axes, in one style: arrays and texts in, artists out.

Plots of records, campaigns, models and validations, and figures of reports, are made of these functions.
"""

from hitchid.plots.drawing import DIRECTION_COLOURS as DIRECTION_COLOURS
from hitchid.plots.drawing import LEVEL_COLOURS as LEVEL_COLOURS
from hitchid.plots.drawing import BandedCurve as BandedCurve
from hitchid.plots.drawing import ErrorBin as ErrorBin
from hitchid.plots.drawing import SpeedCurve as SpeedCurve
from hitchid.plots.drawing import draw_band as draw_band
from hitchid.plots.drawing import draw_bode as draw_bode
from hitchid.plots.drawing import draw_commands as draw_commands
from hitchid.plots.drawing import draw_correlation as draw_correlation
from hitchid.plots.drawing import draw_curves as draw_curves
from hitchid.plots.drawing import draw_dead_zone as draw_dead_zone
from hitchid.plots.drawing import draw_displacement as draw_displacement
from hitchid.plots.drawing import draw_error_bins as draw_error_bins
from hitchid.plots.drawing import draw_errors as draw_errors
from hitchid.plots.drawing import draw_measured as draw_measured
from hitchid.plots.drawing import draw_predicted as draw_predicted
from hitchid.plots.drawing import draw_segments as draw_segments
from hitchid.plots.drawing import draw_speed_map as draw_speed_map
from hitchid.plots.style import COLOURS as COLOURS
from hitchid.plots.style import COMPARED as COMPARED
from hitchid.plots.style import FAINT as FAINT
from hitchid.plots.style import GRID as GRID
from hitchid.plots.style import INK as INK
from hitchid.plots.style import PAGE_IN as PAGE_IN
from hitchid.plots.style import canvas as canvas
from hitchid.plots.style import legend_above as legend_above
from hitchid.plots.style import logarithmic as logarithmic
from hitchid.plots.style import styled as styled
