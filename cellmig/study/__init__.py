"""Studies over runs: pictures, comparisons."""
