"""References by physics: a module each; `cellmig/study/verify.py` tells how to add one."""
