"""Fields of KernelData, the structure that Python fills and C works on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Field:
    """A number or an array of the kernel.

    name : in C and in Python;  ctype : "double", "long" or a pointer such as "double *";  shape : of the array, such as
    "(n_rows, 2)", "" for a number;  unit : such as "µm";  doc : what it is, and which ranks exchange it.
    """

    name: str
    ctype: str
    shape: str = ""
    unit: str = ""
    doc: str = ""


_TYPES = {
    # sizes
    "n_owned": "long", "n_rows": "long", "n_local": "long", "n_shared_blocks": "long", "n_owned_blocks": "long",
    "n_blocks": "long",
    # state (ux uy vx vy) of owned and ghosts, and what the rows keep
    "state": "double *", "X": "double *", "F": "double *", "Q": "double *", "force": "double *",
    "volume": "double *", "inverse_mass": "double *", "per_mass": "double *", "bulk_damping": "double *",
    "step_memory": "double *", "viscous_loss": "double *", "artificial_dissipation": "double *",
    # blocks of rows, and by their stencils the neighbours
    "block": "int32_t *",
    "first": "long *", "column": "uint32_t *", "gradient": "coefficient *", "adjoint": "coefficient *",
    "first_outer": "long *", "column_outer": "uint32_t *", "outer": "coefficient *",
    "first_stiff": "long *", "column_stiff": "uint32_t *", "stiff": "coefficient *",
    # step control
    "least_gap": "double *", "J_range": "double *", "bound": "double *",
    "viscous_weight": "double *", "elastic_weight": "double *",
    # surfaces: all segments, those near the substrate, and the push at their ends
    "n_segments": "long", "segment": "int32_t *", "length": "double *", "n_near": "long", "near": "int32_t *",
    "substrate_bonds": "double", "substrate_floor": "double", "substrate_depth": "double", "push": "double *",
    "pushed": "double *", "bond_impulse": "double *",
    "friction_loss": "double *", "protrusion_impulse": "double *", "external_work": "double *",
    # cells that protrude: all of their surface with weights, their segments near the substrate, and what is found there
    "mover_of": "int32_t *", "n_movers": "long", "first_mover": "long *", "mover": "int32_t *",
    "mover_weight": "double *", "first_grip": "long *", "grip": "int32_t *", "firm": "double", "middle": "double *",
    "hold": "double *",
    # contact between cells
    "n_contact_nodes": "long", "contact_node": "int32_t *", "first_candidate": "long *", "candidate": "int32_t *",
    "n_contact_segments": "long", "contact_segment": "int32_t *", "contact_length": "double *",
    "contact_pull": "double *", "closest_point": "void *", "contact_slot": "int32_t *", "contact_impulse": "double *",
    "contact_bonds": "double", "contact_floor": "double", "contact_cutoff": "double",
    # director (θ, torque) and its gradient, axis, flux
    "director": "double *", "director_gradient": "double *", "director_axis": "double *", "director_flux": "double *",
    "director_mobility": "double *", "director_weight": "double *", "n_anchors": "long", "n_anchors_anywhere": "long",
    "anchor": "int32_t *", "anchor_offset": "double *", "anchor_owned": "int32_t *",
    # supports, loads and plates at the time of the clock
    "clock": "double *", "n_held": "long", "held": "int32_t *", "held_value": "double *", "held_curve": "int32_t *",
    "held_before": "double *", "reaction": "double *",
    "n_loaded": "long", "loaded": "int32_t *", "load": "double *", "load_before": "double *",
    "n_dead": "long", "dead": "int32_t *", "dead_force": "double *", "dead_curve": "int32_t *",
    "n_pressed": "long", "pressed": "int32_t *", "pressure": "double *", "pressed_curve": "int32_t *",
    "n_plates": "long", "plate": "double *", "plate_curve": "int32_t *", "n_platable": "long",
    "platable": "int32_t *", "plate_before": "double *", "plate_force": "double *",
    # parameters of the laws
    "substrate": "double *", "contact": "double *", "protrusion": "double *", "cortex": "double *",
    "friction": "double *", "load_curves": "double *",
    # ghosts
    "state_vec": "void *", "director_vec": "void *",
    "acceleration": "double *",
}
FIELDS = tuple(Field(name, ctype) for name, ctype in _TYPES.items())
