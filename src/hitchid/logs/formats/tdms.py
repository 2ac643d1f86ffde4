"""LabVIEW TDMS files: channels in groups, with waveform clocks and time stamps."""

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.library import (
    as_log_errors,
    floats,
    import_optional,
    is_time,
    match_clocked_channels,
    unit_text,
)
from hitchid.logs.units import unit_of_column

SUFFIXES = (".tdms",)
KIND = "a TDMS file"
GROUP = "log"  # group of written channels
# From the TDMS file format: bytes of a lead-in, its flag for big-endian, the length of an unfinished segment.
LEAD_IN, BIG_ENDIAN, UNFINISHED = 28, 1 << 6, 0xFFFF_FFFF_FFFF_FFFF
# A channel's path, or its start time: type and value behind the name.
START = re.compile(rb"(?P<path>/'(?:[^']|'')*'/'(?:[^']|'')*')|wf_start_time(?P<start>.{20})", re.DOTALL)

Channel = Any  # of npTDMS, which has no types


class _Waveform(NamedTuple):
    sample_count: int
    offset_s: float
    increment_s: float
    start: tuple[int, int]  # s and 2^-64 s since 1904


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected channels of a TDMS file; the time is optional if all are waveforms."""
    nptdms = import_optional("nptdms", "tdms", path)
    with as_log_errors(path, KIND), path.open("rb") as stream:
        data_bytes = _count_data_bytes(path, stream)
        # From the open file: npTDMS then ignores an index file, which may belong to another recording.
        with nptdms.TdmsFile.open(stream, raw_timestamps=True) as log:
            all_channels = [channel for group in log.groups() for channel in group.channels()]
            _check_sample_counts(path, all_channels, data_bytes, log.file_status.channel_statuses or {})
            numeric_channels = {f"{c.group_name}/{c.name}": c for c in all_channels if _holds_numbers(c)}
            waveforms = {name: w for name, c in numeric_channels.items() if (w := _waveform(c)) is not None}
            matches = match_clocked_channels(path, list(numeric_channels), selection, waveforms)
            clocks = _clocks(path, {name: waveforms[name] for name in matches.values() if name in waveforms})
            channels = {
                requested: _channel(path, name, numeric_channels[name], clocks.get(name))
                for requested, name in matches.items()
            }
    return Content(path, channels)


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of doubles, each under a name that may end in its unit, as channels of one group."""
    nptdms = import_optional("nptdms", "tdms", path, purpose="write")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    GROUP,
                    name,
                    floats(values),
                    {"unit_string": unit} if (unit := unit_of_column(name)) else {},
                )
                for name, values in columns.items()
            ]
        )


def _count_data_bytes(path: Path, stream: BinaryIO) -> int:
    """Return the bytes of raw data in all segments."""
    size = stream.seek(0, 2)
    position = segment_number = data_bytes = 0
    starts: dict[bytes, bytes] = {}
    # An empty file has no segment to begin with, and must be refused.
    while position < size or not segment_number:
        segment_number += 1
        stream.seek(position)
        lead_in = stream.read(LEAD_IN)
        if not lead_in or not b"TDSm".startswith(lead_in[:4]):
            raise LogError(path, f"cannot be read as {KIND}: no segment starts at byte {position}")
        length = raw_offset = 0
        if len(lead_in) == LEAD_IN:
            length, raw_offset = struct.unpack(f"{'>' if lead_in[4] & BIG_ENDIAN else '<'}QQ", lead_in[12:])
        end, raw = position + LEAD_IN + length, length - raw_offset
        if end > size:
            ends = (
                f"ends at byte {end}" if end < UNFINISHED else f"from byte {position} on was never finished"
            )
            raise LogError(path, f"is truncated: segment {segment_number} {ends}, the file has {size}")
        if raw < 0:
            raise LogError(
                path, f"cannot be read as {KIND}: the data of segment {segment_number} is outside the segment"
            )
        channel = b""
        # npTDMS keeps only the last start of a channel: an appended recording would continue the one before.
        for entry in START.finditer(stream.read(end - stream.tell() - raw)):
            channel, start = entry["path"] or channel, entry["start"]
            if start is not None and starts.setdefault(channel, start) != start:
                problem = f"contains several recordings, the next from segment {segment_number}; expected one"
                raise LogError(path, f"{problem} recording per file", column=channel.decode(errors="replace"))
        data_bytes += raw
        position = end
    stream.seek(0)
    return data_bytes


def _check_sample_counts(
    path: Path, channels: Sequence[Channel], data_bytes: int, last_segment: Mapping[str, Channel]
) -> None:
    """Check the number of samples against the metadata, in the last segment and in all."""
    for channel in channels:
        status = last_segment.get(channel.path)
        if status is not None and status.read_length < status.expected_length:
            counts_text = f"holds {status.read_length} of {status.expected_length} samples at its end"
            raise LogError(
                path, f"is truncated: {counts_text}", column=f"{channel.group_name}/{channel.name}"
            )
    non_empty = [channel for channel in channels if len(channel)]
    sizes = [channel.data_type.size for channel in non_empty]
    if None in sizes:  # text and raw DAQmx data: npTDMS checks their offsets
        return
    expected_bytes = sum(len(channel) * size for channel, size in zip(non_empty, sizes, strict=True))
    if expected_bytes != data_bytes:
        raise LogError(
            path,
            f"cannot be read as {KIND}: its channels take {expected_bytes} bytes, "
            f"its segments hold {data_bytes}",
        )


def _holds_numbers(channel: Any) -> bool:
    return len(channel) > 1 and np.dtype(channel.dtype).kind in "fiubM"


def _channel(path: Path, name: str, channel: Any, clock_s: np.ndarray | None) -> LogChannel:
    samples = channel[:]
    if len(samples) != len(channel):
        raise LogError(path, f"is truncated: holds {len(samples)} of {len(channel)} samples", column=name)
    if np.dtype(channel.dtype).kind == "M":
        # Seconds and fractions since the first are subtracted separately: a double holds no date in ns.
        seconds = samples["seconds"].astype(np.int64)
        fractions = samples["second_fractions"].astype(np.float64)
        since_first = (seconds - seconds[0]).astype(np.float64) + (fractions - fractions[0]) * 2.0**-64
        return LogChannel(since_first, "s", clock_s)
    return LogChannel(floats(samples), unit_text(channel.properties.get("unit_string")), clock_s)


def _waveform(channel: Any) -> _Waveform | None:
    increment, offset = (channel.properties.get(name) for name in ("wf_increment", "wf_start_offset"))
    axis = unit_text(channel.properties.get("wf_xunit_string"))
    if not isinstance(increment, int | float) or not np.isfinite(increment) or increment <= 0:
        return None
    if axis is not None and not is_time(axis):  # such as a spectrum
        return None
    stamp = channel.properties.get("wf_start_time")
    start = (0, 0) if stamp is None else (int(stamp.seconds), int(stamp.second_fractions))
    return _Waveform(len(channel), float(offset or 0.0), float(increment), start)


def _clocks(path: Path, waveforms: Mapping[str, _Waveform]) -> dict[str, np.ndarray]:
    """Return the clock of each waveform from the earliest start, one array for equal waveforms."""
    starts = [waveform.start for waveform in waveforms.values()]
    # LabVIEW writes 1904 for a start that was not set.
    without_start = [name for name, waveform in waveforms.items() if not waveform.start[0]]
    if without_start and len(without_start) < len(waveforms):
        problem = "has no start time although other channels have one; expected all or none"
        raise LogError(path, problem, column=without_start[0])
    clocks: dict[_Waveform, np.ndarray] = {}
    for waveform in waveforms.values():
        delay = [start - first_start for start, first_start in zip(waveform.start, min(starts), strict=True)]
        delay_s = delay[0] + delay[1] * 2.0**-64 if not without_start else 0.0
        ticks = waveform.increment_s * np.arange(waveform.sample_count)
        clocks.setdefault(waveform, waveform.offset_s + delay_s + ticks)
    return {name: clocks[waveform] for name, waveform in waveforms.items()}
