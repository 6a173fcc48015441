"""Ranks: who owns which particle, what they tell each other, sums and random numbers that do not depend on them."""
