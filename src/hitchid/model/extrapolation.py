"""Warnings where a free run leaves the operating range of the identification tests."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from hitchid.data.record import COMMAND, DISPLACEMENT, Record
from hitchid.model.channel import Channel
from hitchid.model.free_run import FreeRun


def warnings(
    channels: Mapping[str, Channel], units: Mapping[str, str], record: Record, run: FreeRun
) -> tuple[str, ...]:
    """Return a sentence for each signal outside its range, and for each limit that clips the free run.

    Args:
        channels, units: channels and units of the model.
        record: on the model's clock and in its units.
        run: free run of the record.
    """
    displacement, active_channel = run
    sentences = []
    for number, (direction, channel) in enumerate(channels.items()):
        in_charge = active_channel == number
        batch = channel.batch([record], [float(displacement[0])])
        padding = (0, batch.command.shape[1] - displacement.size)
        padded = np.pad(displacement, padding, mode="edge")
        for name, is_outside in channel.out_of_range(batch, jnp.asarray(padded)[None]).items():
            samples = int(np.sum(is_outside[0, : len(record)] & in_charge))
            if samples:
                sentences.append(
                    f"{direction}: the {name} is outside the identified range, "
                    f"{describe_range(channel, units, name)}, in {samples} of {len(record)} samples"
                )
    limits = next(iter(channels.values())).limits
    samples = 0 if limits is None else int(np.sum(limits.at_soft_limit(displacement)))
    if limits is not None and samples:
        sentence = limits.sentence(units[DISPLACEMENT])
        sentences.append(f"{sentence}; this limit applies in {samples} of {displacement.size} samples")
    return tuple(sentences)


def describe_range(channel: Channel, units: Mapping[str, str], name: str) -> str:
    """Return the range of `command`, `displacement` or `load` in the identification tests as text."""
    load = channel.benchmark.covariate or ""
    role = {"command": COMMAND[channel.direction], "displacement": DISPLACEMENT, "load": load}[name]
    signal_range = getattr(channel.operating_range, name)
    suffix = " beyond the dead zone" if name == "command" else ""
    ends = f"{float(signal_range.lowest):.4g} to {float(signal_range.highest):.4g}"
    return f"{ends} {units.get(role, '')}{suffix}"
