"""Data of the report sections of one direction."""

from dataclasses import dataclass

from hitchid.model.trace import ChannelTraceFile
from hitchid.validation import Accuracy, ChannelResult
from hitchid.validation.report_data import DirectionData


@dataclass(frozen=True)
class DirectionContext:
    """Data of one direction of a report.

    Attributes:
        direction: lifting or lowering.
        result: validation result of the direction.
        trace: trace of the identification; None if it was not saved.
        data: speed over command and slow ramps, in the model's units.
        step_s: sampling time, s.
        unit: of the displacement in the logs.
    """

    direction: str
    result: ChannelResult
    trace: ChannelTraceFile | None
    data: DirectionData
    step_s: float
    unit: str

    @property
    def accuracy(self) -> Accuracy:
        """Errors on the unseen tests."""
        return self.result.accuracy

    def figure_name(self, name: str) -> str:
        """Return the name of a figure of this direction."""
        return f"{self.direction}-{name}"
