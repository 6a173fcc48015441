"""Runs, one or many: what they leave, resume, compare, sweep."""
