"""State of a hitch at one sample."""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Float32, Int

from hitchid.networks.error_compensator import FeatureState
from hitchid.networks.lstm import LstmState
from hitchid.structures import ValveState


class SpeedCompensatorState(NamedTuple):
    """State of the compensator for free run.

    Attributes:
        hidden: of its networks, shape [M, 1, H].
        factor: on the benchmark's speed in this block.
        command, travel_increment: sums over this block so far, of effective command and of the benchmark's
            travel.
    """

    hidden: LstmState
    factor: Float[Array, ""]
    command: Float[Array, ""]
    travel_increment: Float[Array, ""]


class ChannelState(NamedTuple):
    """State of one channel.

    Attributes:
        valve: state of the valve, which follows its command whether in charge or not.
        plant: of the benchmark.
        samples_in_charge: samples since the channel took charge.
        correction: of the compensator for free run; None where there is none.
    """

    valve: ValveState
    plant: Float[Array, " n"]
    samples_in_charge: Int[Array, ""]
    correction: SpeedCompensatorState | None


class HitchState(NamedTuple):
    """State of a hitch at one sample; displacements in the model's unit.

    Attributes:
        displacement: the model's output: with measurements the benchmark's plus the predicted error,
            without any, the free run.
        error: predicted error of the benchmark.
        benchmark: the benchmark's, as if there were no end stop, but within the limits of the plant.
        free_run: free run, compensated, likewise.
        start: displacement at which the channel in charge took over.
        mode: place of the channel in charge; −1 while nothing has moved yet.
        samples_since_measurement: samples since a displacement was measured; −1 if none ever was.
        commands: last valid lifting and lowering command, shape [2].
        command_missing: whether a command was missing and the last one held.
        both_valves_active: whether both valves were on; then lowering counts.
        load: second measured input, before motion.
        feature_state: of the compensator in charge.
        channels: of each channel.
        hidden: of the network in charge: h and c of the LSTM that predicts and of the one whose
            window follows, shape [2, 2, H].
    """

    displacement: Float[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free_run: Float[Array, ""]
    start: Float[Array, ""]
    mode: Int[Array, ""]
    samples_since_measurement: Int[Array, ""]
    commands: Float[Array, "2"]
    command_missing: Bool[Array, ""]
    both_valves_active: Bool[Array, ""]
    load: Float[Array, ""]
    feature_state: FeatureState
    channels: tuple[ChannelState, ...]
    hidden: Float32[Array, "2 2 h"]


class NetworkInput(NamedTuple):
    """Inputs of the network of the channel in charge.

    Attributes:
        channel_index: place of the channel.
        scaled_features: features, shape [10].
        index_in_window: samples read, modulo L.
        trust: factor on the predicted increment; zero where none is predicted.
        reset: whether its state is reset.
        error: predicted error so far.
        benchmark: displacement without error; free_run: without measurements.
        has_measurement: whether a displacement was ever measured.
    """

    channel_index: Int[Array, ""]
    scaled_features: Float32[Array, "10"]
    index_in_window: Int[Array, ""]
    trust: Float[Array, ""]
    reset: Bool[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free_run: Float[Array, ""]
    has_measurement: Bool[Array, ""]
