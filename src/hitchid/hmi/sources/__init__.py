"""Sources by name: the virtual bench, logs, JSON lines, CAN, and sources of other modules."""

import importlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from hitchid.errors import InputError
from hitchid.hmi.source import Source


def _rig(name: str) -> Source:
    from hitchid.hmi.sources.simulated import VirtualBench

    return VirtualBench(name or "nominal")


def _replay(log: str) -> Source:
    from hitchid.hmi.sources.simulated import Replay

    return Replay(log)


def _stdin(_: str) -> Source:
    from hitchid.hmi.sources.json_lines import FileTransport, JsonLines

    return JsonLines(FileTransport(), "standard input")


def _serial(path: str) -> Source:
    from hitchid.hmi.sources.json_lines import FileTransport, JsonLines

    device, _, baud = path.partition("@")
    if baud and not baud.isdecimal():
        raise InputError(f"serial: expected DEVICE@BAUD, got '{path}'")
    transport = FileTransport(device, int(baud)) if baud else FileTransport(device)
    return JsonLines(transport, f"serial {device}", can_move=True)


def _udp(port: str) -> Source:
    from hitchid.hmi.sources.json_lines import JsonLines, UdpTransport

    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"udp: expected a port from 1 to 65535, got '{port}'")
    return JsonLines(UdpTransport(int(port)), f"UDP port {port}", can_move=True)


def _can(path: str) -> Source:
    from hitchid.hmi.sources.can_bus import CanBus

    return CanBus(path)


SOURCES: Mapping[str, Callable[[str], Source]] = MappingProxyType(
    {"rig": _rig, "replay": _replay, "stdin": _stdin, "serial": _serial, "udp": _udp, "can": _can}
)
"""Name to the function from what follows the colon to the source; each imports what it needs."""


def make_source(text: str) -> Source:
    """Return a source by `NAME` or `NAME:ARGUMENT`, or by `MODULE:OBJECT`, an object that makes one.

    Raises:
        InputError: there is no such source, or it cannot be used.
    """
    name, _, argument = text.partition(":")
    if name in SOURCES:
        return SOURCES[name](argument)
    if not argument:
        raise InputError(f"source: expected one of {', '.join(SOURCES)} or MODULE:OBJECT, got {text}")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    try:
        source = getattr(importlib.import_module(name), argument)()
    except Exception as error:  # whatever a foreign module raises
        raise InputError(f"source: {text} cannot be imported: {error}") from error
    if not isinstance(source, Source):
        raise InputError(f"source: {text} is no source; expected what hitchid.hmi.Source names")
    return source
