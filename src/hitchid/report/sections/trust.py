"""Section on prediction bands and residual tests of one direction."""

from hitchid.report import figure_data, figures
from hitchid.report.document import Block, Picture, Pictures, ReportSection
from hitchid.report.sections.context import DirectionContext
from hitchid.report.tables import band_table, residual_table
from hitchid.validation.names import FREE_RUN


def trust(context: DirectionContext) -> ReportSection:
    """Return the section on bands and on tests of the errors."""
    result, unit = context.result, context.unit
    blocks: list[Block] = []
    pictures = []
    bands = context.accuracy.bands
    if bands is not None:
        blocks.append(band_table(context.direction, bands, unit))
        pictures.append(
            Picture(
                context.figure_name("coverage"),
                figures.coverage(bands, context.step_s),
                "Share of unseen samples inside the bands, and their nominal coverage.",
                "Coverage of the bands in percent over the horizon.",
                data=figure_data.coverage(bands, context.step_s),
            )
        )
    free_run = result.residuals[FREE_RUN]
    if free_run is not None:
        blocks.append(residual_table(context.direction, result.residuals, unit))
        pictures += [
            Picture(
                context.figure_name("correlations"),
                figures.residual_correlations(free_run),
                "Free run: autocorrelation of the errors and correlation with the command. Values outside "
                "the bounds are errors that a better model could explain.",
                "Autocorrelation of the errors and their correlation with the command, with 99 % bounds.",
                data=figure_data.residual_correlations(free_run),
            ),
            Picture(
                context.figure_name("places"),
                figures.residuals_by_variable(free_run, unit, context.data.command_unit),
                "Free run: mean error (bar) and its spread (line) by displacement, speed and command beyond "
                "the dead zone. A bar away from zero is a systematic error.",
                f"Mean and spread of the errors in {unit} by displacement, speed and command.",
                data=figure_data.residuals_by_variable(free_run, unit, context.data.command_unit),
            ),
        ]
    return ReportSection("Trust", (*blocks, *([Pictures(tuple(pictures))] if pictures else [])))
