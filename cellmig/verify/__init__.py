"""Is it right: references with known solutions, sensitivity, random scenes."""
