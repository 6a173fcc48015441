"""Cues that turn the polarity of cells, one law per module, and what cells sense."""
