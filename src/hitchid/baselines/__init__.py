"""Models without physics that a grey box must beat: definition and fit of each in one file."""
