"""Search and training of one direction."""

from collections.abc import Iterator

from hitchid.report import figure_data, figures
from hitchid.report.document import Block, Picture, Pictures, ReportSection, Text, sentence
from hitchid.report.sections.context import DirectionContext
from hitchid.report.tables import search_table
from hitchid.report.trace_file import ChannelTraceFile


def search(context: DirectionContext) -> ReportSection:
    """Return the section on the identification; its trace is in the model's units."""
    trace, searches = context.trace, context.result.searches
    blocks: list[Block] = []
    pictures = []
    if trace is not None:
        blocks += [Text(sentence(notice)) for notice in trace.notices]
        pictures += _trace_pictures(context, trace)
    if searches:
        blocks.append(search_table(context.direction, searches, context.unit))
        pictures.append(
            Picture(
                context.figure_name("searches"),
                figures.searches(searches, context.unit),
                "Searches with equal evaluations: the median run, and the final error of each seed.",
                f"Best RMSE over the evaluations for {', '.join(summary.name for summary in searches)}.",
                data=figure_data.searches(searches, context.unit),
            )
        )
    return ReportSection("Search and training", (*blocks, *([Pictures(tuple(pictures))] if pictures else [])))


def _trace_pictures(context: DirectionContext, trace: ChannelTraceFile) -> Iterator[Picture]:
    unit, search = context.data.unit, trace.phase1
    caption = "Search: best fitness so far (weighted over the tests), and the parameters of the best member."
    if len(search.searched) < len(search.uncertainty.parameters):
        caption += " The plain form was searched; dotted: the model's form, which grew from it."
    yield Picture(
        context.figure_name("convergence"),
        figures.convergence(search, unit),
        caption,
        "Best RMSE and the parameters that gave it, over the iterations of the search.",
        data=figure_data.convergence(search, unit),
    )
    if trace.phase2 is not None:
        yield Picture(
            context.figure_name("losses"),
            figures.losses(trace.phase2),
            "Training of the LSTM correction; the epoch with the smallest validation loss is used.",
            f"Losses over epochs; epoch {trace.phase2.best_epoch} is used.",
            data=figure_data.losses(trace.phase2),
        )
    if trace.candidates:
        chosen = next(candidate.name for candidate in trace.candidates if candidate.chosen)
        yield Picture(
            context.figure_name("structures"),
            figures.structures(trace.candidates, unit),
            _structures_caption(trace, unit),
            f"RMSE of {len(trace.candidates)} structures; chosen: {chosen}.",
            data=figure_data.structures(trace.candidates, unit),
        )


def _structures_caption(trace: ChannelTraceFile, unit: str) -> str:
    caption = (
        "Free-run RMSE of each structure, on all tests and in cross-validation over levels. A larger "
        "structure is taken where it is significantly better in cross-validation, as shown or with a gain "
        "fitted to each test, which this figure does not include; in the other of the two it must not be "
        "significantly worse."
    )
    if trace.choice_held_out_rmse is not None:
        error = f"{trace.choice_held_out_rmse:.4g} {unit}"
        caption += f" On levels that neither fitted nor chose the structure: {error}."
    return caption
