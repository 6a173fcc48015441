"""cellmig: collective cell migration by a meshfree particle method (Bai, Lin & Zeng 2019)."""

__version__ = "0.1.0.dev0"
