"""What a run says of itself at its start."""

from __future__ import annotations

from cellmig.case.schema import Case
from cellmig.simulation import Simulation
from cellmig.solve.step import binding


def step_said(stable: dict[str, float], factor: float, fixed: float | None) -> str:
    """What the time step [µs] will be and why; `stable` : by mechanism;  `fixed` : as the user says."""
    mechanism, limit = binding(stable)
    if not fixed:
        return (f"about {1e3 * factor * limit:.3g} ns, {factor:g} of the stable one, which {mechanism} sets; follows "
                "the deformation")
    said = f"{1e3 * fixed:.3g} ns as given, {fixed / limit:.3g} times the stable one, which {mechanism} sets"
    return said if fixed <= limit else f"{said}: TOO LARGE"


def load_said(case: Case) -> str:
    """What the load steps of a static case are."""
    return (f"{case.time.samples}, one for each sample; one that finds no equilibrium is cut; time is what loads "
            "depend on, nothing moves")


def skipped_said(skipped: dict[str, str]) -> list[tuple[str, str]]:
    """What the scene does not need, a row each."""
    rows = [f"{name}: {why}" for name, why in skipped.items()] or ["nothing"]
    return [("" if number else "skipped", row) for number, row in enumerate(rows)]


def laws_said(case: Case, simulation: Simulation) -> list[tuple[str, str]]:
    """The laws of a scene as rows for the log, with what is numerical in them."""
    rows = []
    for name, law in case.materials.items():
        if law not in simulation.scene.materials:
            continue
        viscosity = law.numerical_viscosity(max(t.spacing for t in simulation.scene.templates)) / 1e3
        said = f"{law.law}, stabilised with {viscosity:.3g} mPa s"
        said += f" and {law.numerical_modulus / 1e3:.3g} kPa" if law.numerical_modulus else ""
        if hasattr(law, "reduced_bulk_modulus"):
            said += f", bulk modulus reduced from {law.bulk_modulus / 1e6:g} to {law.reduced_bulk_modulus / 1e6:g} MPa"
        rows.append((name, said))
    t = simulation.terms
    for name, law in (("substrate", t.substrate), ("between cells", t.contact)):
        if law is not None and law.work:
            rows.append((name, f"{law.law}, work of adhesion {law.work:g} pN/µm, range {1e3 * law.range:g} nm"))
    if t.protrusion is not None and case.protrusion:
        rows.append(("protrusion", f"{', '.join(case.protrusion.cells)}; strength {t.protrusion.strength:g}, "
                                   f"height {t.protrusion.height:g} µm"))
    return rows


def span(values: list) -> str:
    """Least and largest of some values, as text."""
    low, high = min(values), max(values)
    text = "{:.4g}" if isinstance(low, float) else "{}"
    return text.format(low) if low == high else f"{text.format(low)}-{text.format(high)}"
