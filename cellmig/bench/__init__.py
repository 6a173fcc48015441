"""Performance: speed, parallel scaling, run time against error."""
