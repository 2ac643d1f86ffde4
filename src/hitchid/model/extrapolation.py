"""Where a free run is outside the operating range of the identification tests."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.data.test_kinds import effective_command
from hitchid.model.channel import Channel
from hitchid.model.free_run import FreeRun, FreeRunInputs
from hitchid.model.loads import channel_load


class OutOfRange(NamedTuple):
    """One signal outside its range.

    Attributes:
        sentence: names the signal, its range and the number of samples outside.
        samples: which samples are outside, of the shape of the free run.
    """

    sentence: str
    samples: Bool[np.ndarray, "*m n"]


def out_of_range(
    channels: Sequence[Channel], units: Mapping[str, str], inputs: FreeRunInputs, run: FreeRun
) -> tuple[OutOfRange, ...]:
    """Return each signal outside its range while its channel is in charge, and limits that clip the run.

    Args:
        channels, units: channels and units of the model.
        inputs: inputs of the free runs.
        run: the free runs.
    """
    displacement, active_channel, _ = run
    runs = f" of {len(displacement)} runs" if displacement.ndim > 1 else ""
    of_all = f"of {displacement.size} samples{runs}"
    found = []
    for number, channel in enumerate(channels):
        for name, mask in _masks(channels, number, inputs, displacement).items():
            samples = mask & (active_channel == number)
            described = describe_range(channel, units, name)
            found.append(
                OutOfRange(
                    f"{channel.direction}: the {name} is outside the identified range, {described}, "
                    f"in {samples.sum()} {of_all}",
                    samples,
                )
            )
    limits = channels[0].limits
    if limits is not None:
        samples = limits.at_soft_limit(displacement)
        sentence = f"{limits.sentence(units[DISPLACEMENT])}; this limit applies in {samples.sum()} {of_all}"
        found.append(OutOfRange(sentence, samples))
    return tuple(signal for signal in found if signal.samples.any())


def _masks(
    channels: Sequence[Channel], number: int, inputs: FreeRunInputs, displacement: np.ndarray
) -> dict[str, Bool[np.ndarray, "*#m n"]]:
    """Return `command`, `displacement` and `load` to the samples outside the range of a channel."""
    channel = channels[number]
    command = inputs.commands[:, DIRECTIONS.index(channel.direction)]
    signals = {
        "command": np.abs(effective_command(command, channel.dead_zone)),
        "displacement": displacement,
    }
    outside = {
        name: np.asarray(getattr(channel.operating_range, name).trust(jnp.asarray(values))) < 1
        for name, values in signals.items()
    }
    load = channel_load(channels, number, jnp.asarray(inputs.initial.load))
    return {**outside, "load": np.asarray(channel.operating_range.load_trust(load))[..., None] < 1}


def describe_range(channel: Channel, units: Mapping[str, str], name: str) -> str:
    """Return the range of `command`, `displacement` or `load` in the identification tests as text."""
    signal_range = getattr(channel.operating_range, name)
    if name == "load":
        covariates = channel.benchmark.covariates
        ends = zip(signal_range.lowest.tolist(), signal_range.highest.tolist(), strict=True)
        ranges = [f"{low:.4g} to {high:.4g}" for low, high in ends]
        if len(ranges) == 1:
            return f"{ranges[0]} {units.get(''.join(covariates), '')}"
        named = zip(covariates, ranges, strict=True)
        return ", ".join(f"{covariate} {text} {units.get(covariate, '')}" for covariate, text in named)
    role = {"command": COMMAND[channel.direction], "displacement": DISPLACEMENT}[name]
    suffix = " beyond the dead zone" if name == "command" else ""
    ends = f"{float(signal_range.lowest):.4g} to {float(signal_range.highest):.4g}"
    return f"{ends} {units.get(role, '')}{suffix}"
