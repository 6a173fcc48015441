"""What tractions on the substrate tell: net force, dipole, and the stress of the layer of cells above."""

from __future__ import annotations

import numpy as np


def moments(place: np.ndarray, traction: np.ndarray, size: float, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Net force and dipole of tractions of cells on the substrate.

    Parameters
    ----------
    place : (m, k) float -- middles of the pieces of the substrate along its k axes [µm].
    traction : (m, k) float -- along the substrate [Pa].
    size : float -- of a piece [µm, in space µm²].
    about : (k,) float -- origin of the dipole [µm]; it matters where the net force is not zero.

    Returns
    -------
    (k,) float -- net force ∫ T dx [pN/µm, in space pN]; without inertia it is the drag of the medium on the cells.
    (k, k) float -- dipole ∫ x T dx [pN, in space pN µm]; its trace is negative where cells contract the substrate.
    """
    return size * traction.sum(axis=0), size * (place - about).T @ traction


def tension(traction: np.ndarray, width: float) -> np.ndarray:
    """Tension h σ̄(x) = ∫ T dx' of the layer (..., m + 1) [pN/µm] at the edges of m pieces of the substrate.

    traction : along x on the substrate (..., m) [Pa], in space its integral across x [pN/µm], and the tension in pN;
    width : of a piece [µm].

    The balance of forces of what is left of a cut (Trepat et al. 2009, Nat. Phys. 5:426-430), without inertia and but
    for the drag of the medium, which is what is left at the right end.  It is all that crosses the cut: the stress in
    the cells times their height h, the tension of their membranes, and the force between neighbours.
    """
    return np.cumsum(width * np.pad(traction, [(0, 0)] * (traction.ndim - 1) + [(1, 0)]), axis=-1)
