"""References by physics: a module each; `cellmig/verify/verify.py` tells how to add one."""
