"""Load curves: factors in time of prescribed displacements and of loads."""

from __future__ import annotations

from math import pi

from numpy import cos, maximum, minimum, sin, where

from ..case.registry import law, quantity


@law("load_curve", "constant")
class Constant:
    """The factor 1 at all times."""

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return 1.0 + 0.0 * t

    def rate(self, t):
        """First derivative of the factor [1/µs] at the time t [µs]."""
        return 0.0 * t

    def acceleration(self, t):
        """Second derivative of the factor [1/µs²] at the time t [µs], without that of a jump of the rate."""
        return 0.0 * t


@law("load_curve", "ramp")
class Ramp:
    """A factor that grows linearly from 0 to 1 at the time T, and stays 1."""

    duration: float = quantity("us", "time T at which the factor reaches 1", above=0)

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return minimum(maximum(t / self.duration, 0.0), 1.0)

    def rate(self, t):
        """First derivative of the factor [1/µs] at the time t [µs]."""
        return where(t * (self.duration - t) < 0.0, 0.0, 1.0 / self.duration)

    def acceleration(self, t):
        """Second derivative of the factor [1/µs²] at the time t [µs], without that of a jump of the rate."""
        return 0.0 * t


@law("load_curve", "smooth")
class Smooth:
    """A factor that grows from 0 to 1 at the time T as s³ (10 - 15 s + 6 s²), s = t/T, with continuous acceleration.

    Source: the polynomial of least degree whose first two derivatives vanish at both ends.
    """

    duration: float = quantity("us", "time T at which the factor reaches 1", above=0)

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    def rate(self, t):
        """First derivative of the factor [1/µs] at the time t [µs]."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return 30.0 * s**2 * (1.0 - s) ** 2 / self.duration

    def acceleration(self, t):
        """Second derivative of the factor [1/µs²] at the time t [µs], without that of a jump of the rate."""
        s = minimum(maximum(t / self.duration, 0.0), 1.0)
        return 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.duration**2


@law("load_curve", "sine")
class Sine:
    """The factor sin(2π t/T)."""

    period: float = quantity("us", "period T", above=0)

    @property
    def frequency(self) -> float:
        """Angular frequency 2π/T [1/µs]."""
        return 2.0 * pi / self.period

    def value(self, t):
        """Factor [-] at the time t [µs]."""
        return sin(self.frequency * t)

    def rate(self, t):
        """First derivative of the factor [1/µs] at the time t [µs]."""
        return self.frequency * cos(self.frequency * t)

    def acceleration(self, t):
        """Second derivative of the factor [1/µs²] at the time t [µs], without that of a jump of the rate."""
        return -self.frequency**2 * sin(self.frequency * t)
