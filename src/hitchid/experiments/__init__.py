"""Test signals, and campaigns of tests on the virtual bench."""
