"""What a reader of a report looks at first: measured against simulated, and the speed map."""

from hitchid.model import Characteristics
from hitchid.report import figure_data, figures
from hitchid.report.context import DirectionContext
from hitchid.report.document import Picture, Pictures, ReportSection, sentence
from hitchid.report.parameters_section import characteristic_sentences
from hitchid.validation import Predictions
from hitchid.validation.results import BENCHMARK, FREE_RUN, ONE_STEP, shown_tests


def overview_section(context: DirectionContext) -> ReportSection:
    """Return the section with measured and simulated displacement, and the speed over the command."""
    tests, unit = context.accuracy.predictions, context.unit
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    equal_note = " The network correction is not used in simulation." if tests.uncompensated else ""
    rmse = context.accuracy.free_run().rmse
    error_text = "the free run diverged" if rmse is None else f"free-run RMSE {rmse:.3g} {unit}"
    pictures = [
        Picture(
            context.figure_name("outputs"),
            figures.outputs(selected_tests, unit, simulated_models(tests)),
            f"Measured and predicted displacement, and the errors: {selection_text} ({names}).{equal_note}",
            f"Displacement and error over time of {names}; {error_text}.",
            data=figure_data.outputs(selected_tests, unit, simulated_models(tests)),
        )
    ]
    if context.result.characteristics is not None:
        pictures.append(_speed_map(context, context.result.characteristics))
    return ReportSection("Measured and simulated", (Pictures(tuple(pictures)),))


def simulated_models(tests: Predictions) -> tuple[str, ...]:
    """Return the runs that are drawn; the physics model only where the grey box differs from it."""
    return (FREE_RUN, ONE_STEP) if tests.uncompensated else (BENCHMARK, FREE_RUN, ONE_STEP)


def _speed_map(context: DirectionContext, characteristics: Characteristics) -> Picture:
    load = f" One line for each load ({characteristics.load})." if characteristics.load else ""
    return Picture(
        context.figure_name("speed-map"),
        figures.speed_map(characteristics),
        (
            "Speed map: steady speed at mid stroke over the command, as identified, with "
            "its 95 % band; open circles are mean speeds of identification tests during "
            f"constant command.{load}"
        ),
        " ".join(map(sentence, characteristic_sentences(characteristics, context.direction))),
        data=figure_data.speed_map(characteristics),
    )
