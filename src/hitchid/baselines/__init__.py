"""Models without physics that a grey box must beat."""
