"""Sources by name: the virtual bench, logs, JSON lines, CAN, and sources of other modules."""

import importlib
import sys
from pathlib import Path

from hitchid.errors import InputError
from hitchid.hmi.source import Source

NAMES = "rig, replay, stdin, serial, udp, can"


def make_source(text: str) -> Source:
    """Return a source by `NAME` or `NAME:ARGUMENT`, or by `MODULE:OBJECT`, an object that makes one.

    Raises:
        InputError: there is no such source, or it cannot be used.
    """
    name, _, argument = text.partition(":")
    match name:  # each imports what it needs
        case "rig":
            from hitchid.hmi.sources.simulated import VirtualBench

            return VirtualBench(argument or "nominal")
        case "replay":
            from hitchid.hmi.sources.simulated import Replay

            return Replay(argument)
        case "stdin":
            from hitchid.hmi.sources.json_lines import FileTransport, JsonLines

            return JsonLines(FileTransport(), "standard input")  # which takes no commands
        case "serial":
            from hitchid.hmi.sources.json_lines import FileTransport, JsonLines

            device, _, baud = argument.partition("@")
            if baud and not baud.isdecimal():
                raise InputError(f"serial: expected DEVICE@BAUD, got '{argument}'")
            transport = FileTransport(device, int(baud)) if baud else FileTransport(device)
            return JsonLines(transport, f"serial {device}", can_move=True)
        case "udp":
            from hitchid.hmi.sources.json_lines import JsonLines, UdpTransport

            if not argument.isdecimal() or not 0 < int(argument) < 65536:
                raise InputError(f"udp: expected a port from 1 to 65535, got '{argument}'")
            return JsonLines(UdpTransport(int(argument)), f"UDP port {argument}", can_move=True)
        case "can":
            from hitchid.hmi.sources.can_bus import CanBus

            return CanBus(argument)
    if not argument:
        raise InputError(f"source: expected one of {NAMES} or MODULE:OBJECT, got {text}")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # a source of the operator lies in the project
    try:
        source = getattr(importlib.import_module(name), argument)()
    except Exception as error:  # whatever a foreign module raises
        raise InputError(f"source: {text} cannot be imported: {error}") from error
    if not isinstance(source, Source):
        raise InputError(f"source: {text} is no source; expected what hitchid.hmi.Source names")
    return source
