"""The model of the paper: one law, one file."""
