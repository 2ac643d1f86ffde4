"""Signals on a clock, campaigns of tests, units, kinds of test, and strokes cut from mixed logs."""
