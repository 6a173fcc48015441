"""A law in a file of its own: a cortex that stiffens, given to a run by `--law examples/cortex_law.py`.

./run cases/one_cell.toml --law examples/cortex_law.py --set 'cortex={law="stiffening", modulus="50 pN/um", rate=2}'

The run keeps the file's name and hash in its manifest: `resume` loads it again, and refuses it where it has changed.
"""

from numpy import exp

from cellmig.case.registry import law, quantity


@law("cortex", "stiffening")
class Stiffening:
    """Tension T = K (s - 1) exp(b (s - 1)²) of a surface stretched s-fold, after Fung (1967)."""

    modulus: float = quantity("pN/um", "modulus K of the surface at rest", minimum=0)
    rate: float = quantity("", "rate b at which it stiffens", 1.0, above=0)

    def energy(self, stretch):
        """Energy per reference length [pN/µm]."""
        s = stretch - 1.0
        return self.modulus / (2.0 * self.rate) * (exp(self.rate * s * s) - 1.0)

    def tension(self, stretch):
        """Tension [pN/µm], d(energy)/d(stretch)."""
        s = stretch - 1.0
        return self.modulus * s * exp(self.rate * s * s)
