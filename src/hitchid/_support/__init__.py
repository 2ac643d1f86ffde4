"""Shared support, independent of hydraulics: files, checkpoints, progress, precision, notices."""
