"""Shared support without any hydraulics: files, checkpoints, progress, precision, notices."""
