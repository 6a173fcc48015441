"""The model of Bai, Lin & Zeng (2019) and additions to it: laws, each in a file of its own."""
