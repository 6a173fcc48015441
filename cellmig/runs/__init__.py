"""Runs, one or many: execution, checkpoints, results, comparison, sweeps."""
