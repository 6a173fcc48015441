"""Verification: references with known solutions, sensitivity, random scenes."""
