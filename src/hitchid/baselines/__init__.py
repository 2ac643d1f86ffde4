"""Baselines: models without physics that a grey box is compared with; one file each."""
