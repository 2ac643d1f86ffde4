"""What every room may use and what knows nothing of hydraulics: files, checkpoints, progress, precision."""
