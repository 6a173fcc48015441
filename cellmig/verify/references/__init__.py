"""References, one module for each kind of physics; `cellmig/verify/verify.py` describes how to add one."""
