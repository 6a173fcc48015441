"""The version of cellmig."""

__version__ = "0.1.0"
