"""Energies of the particles of a rank, which the ledger sums up."""

from __future__ import annotations

import numpy as np

from ..case.pointwise import pointwise
from .view import View


def energies(m: View, v: np.ndarray) -> dict[str, np.ndarray]:
    """Energies by their names in the ledger, (n_owned,) or a number [pN], at velocities v (n_owned, d) [µm/µs];
    collective.

    They are those of the state for which F is current, and do not include that of the elastic stabilisation.
    """
    terms, mass = m.terms, m.part.owned.field("mass")
    parts: dict[str, np.ndarray] = {"kinetic": 0.5 * mass * (v**2).sum(axis=1)}
    parts |= _stored(m)
    parts["director"] = parts["director"] + m.missed_energy()
    for name, term, law in (("adhesion_substrate", "substrate", terms.substrate),
                            ("adhesion_cells", "contact", terms.contacts)):
        parts[name] = m.surface_force(term)[1] if law is not None else np.zeros(m.n_owned)
    if terms.cortex is not None:
        parts["elastic"] = parts["elastic"] + m.surface_force("cortex")[1]
    return parts


def strain_energy(m: View) -> np.ndarray:
    """Energy of the strain of the owned particles (n_owned,) [pN], of what they are made of alone."""
    parts = _stored(m)
    return parts["elastic"] + parts["compression"]


def _stored(m: View) -> dict[str, np.ndarray]:
    """Energies of the materials (n_owned,) [pN] by their names in the ledger."""
    terms, grades = m.terms, m.grades()
    V, material = m.part.owned.field("V"), m.part.owned.material
    parts = {name: np.zeros(m.n_owned) for name in ("elastic", "compression", "director")}
    rows = {"F": m.state.tensors()[0], **m.internal_fields()}
    everything = {name: values[..., : m.n_owned] for name, values in rows.items()}
    for i, law in enumerate(m.scene.materials):
        on = material == i
        local = {k: q[..., on] for k, q in everything.items()}
        for name, method in ((law.energy_column, "energy"), ("director", "director_energy")):
            if method == "energy" or (terms.director != "none" and hasattr(law, method)):
                density = np.zeros(m.n_owned)
                density[on] = pointwise(law, method, local)
                parts[name] = parts[name] + (V if grades is None else V * grades[: m.n_owned]) * density
    return parts
