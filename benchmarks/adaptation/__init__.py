"""Adaptation on the virtual bench and on measured logs: does it follow, does it leave alone what stays?

Run: python -m benchmarks.adaptation [quick] [follow] [stable] [faults] [bands] [standstill] [delay] …
"""
