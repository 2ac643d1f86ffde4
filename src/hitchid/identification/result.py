"""Result of an identification: the model, and how each direction was identified."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from hitchid._support.summary import Summarised, Summary, first_notes
from hitchid.data.record import DISPLACEMENT
from hitchid.identification.channel_trace import ChannelTrace
from hitchid.identification.trace import describe_channel
from hitchid.model import Hitch, save
from hitchid.model.summary import hitch_summary

MAX_NOTICES = 3  # that are shown; chosen


@dataclass(frozen=True, repr=False)
class Identification(Summarised):
    """An identified model and the trace of its identification.

    Attributes:
        model: the grey-box model.
        channels: direction to trace.
    """

    model: Hitch
    channels: Mapping[str, ChannelTrace]

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the model folder with its traces.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """
        save(self.model, folder, trace=self.describe(), force=force)

    def describe(self) -> dict[str, dict]:
        """Return direction to trace as JSON values."""
        return {direction: describe_channel(trace) for direction, trace in self.channels.items()}

    def free_run_errors(self) -> str:
        """Return the free-run RMSE of the physics models as a sentence, on held-out tests where there are."""
        unit = self.model.units[DISPLACEMENT]
        held_out = {name: trace.choice_held_out_rmse for name, trace in self.channels.items()}
        errors = {
            name: trace.phase1.rmse if held_out[name] is None else held_out[name]
            for name, trace in self.channels.items()
        }
        figures = ", ".join(f"{name} {rmse:.3g} {unit}" for name, rmse in errors.items())
        where = "identification tests" if None in held_out.values() else "tests held out in turn"
        return f"RMSE in free run {figures} on {where}"

    def _summary(self) -> Summary:
        unit = self.model.units[DISPLACEMENT]
        fits = [
            f"{direction}: RMSE {trace.phase1.rmse:.4g} {unit} in free run on the identification tests, "
            f"identified in {sum(trace.seconds.values()):.3g} s"
            for direction, trace in self.channels.items()
        ]
        notices = [f"{name}: {notice}" for name, trace in self.channels.items() for notice in trace.notices]
        shown = first_notes(notices, MAX_NOTICES, "channels")
        title = f"Identification: {' and '.join(self.channels)} at {self.model.step_s:g} s"
        return replace(hitch_summary(self.model), title=title, notes=(*fits, *shown))
