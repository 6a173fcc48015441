"""How prescribed displacements and loads change with time: factors on their values."""

from __future__ import annotations

from math import pi

from numpy import cos, maximum, minimum, sin, where

from ..case.registry import law, quantity


@law("load_curve", "constant")
class Constant:
    """All of it from the start."""

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return 1.0 + 0.0 * t

    def rate(self, t):
        """Its derivative [1/µs]."""
        return 0.0 * t

    def acceleration(self, t):
        """The derivative of that [1/µs²]; a jump of the rate is none."""
        return 0.0 * t


@law("load_curve", "ramp")
class Ramp:
    """Linear from 0 to 1, which stays."""

    duration: float = quantity("us", "time T until all of it is there", above=0)

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return minimum(maximum(t / self.duration, 0.0), 1.0)

    def rate(self, t):
        """Its derivative [1/µs]."""
        return where(t * (self.duration - t) < 0.0, 0.0, 1.0 / self.duration)

    def acceleration(self, t):
        """The derivative of that [1/µs²]; a jump of the rate is none."""
        return 0.0 * t


@law("load_curve", "smooth")
class Smooth:
    """From 0 to 1, which stays, by s³ (10 - 15 s + 6 s²) with s = t/T: neither speed nor acceleration jumps."""

    duration: float = quantity("us", "time T until all of it is there", above=0)

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    def rate(self, t):
        """Its derivative [1/µs]."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return 30.0 * s**2 * (1.0 - s) ** 2 / self.duration

    def acceleration(self, t):
        """The derivative of that [1/µs²]; a jump of the rate is none."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.duration**2


@law("load_curve", "sine")
class Sine:
    """sin(2π t/T), for ever."""

    period: float = quantity("us", "period T", above=0)

    @property
    def frequency(self) -> float:
        """Angular frequency 2π/T [1/µs]."""
        return 2.0 * pi / self.period

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return sin(self.frequency * t)

    def rate(self, t):
        """Its derivative [1/µs]."""
        return self.frequency * cos(self.frequency * t)

    def acceleration(self, t):
        """The derivative of that [1/µs²]; a jump of the rate is none."""
        return -self.frequency**2 * sin(self.frequency * t)
