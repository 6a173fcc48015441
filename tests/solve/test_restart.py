"""A run that goes on from a checkpoint has the bits of one that was never interrupted."""

from __future__ import annotations

import json

import pytest
from scenes import LEFT, NETWORK, RIGHT, bent, built, case, piece, plate, squeezed

from mpi4py import MPI

from cellmig.parallel.collect import broadcast

COMM = MPI.COMM_WORLD
ALONE_TOO = {COMM.size: COMM, 1: MPI.COMM_SELF}.values()  # all ranks, and each by itself where that is another thing
FAST = "cells.0.velocity=['3 um/us', '-0.5*y um/us']"  # lists are renewed within the run
ALONG = "cells.0.velocity=['3 um/us', '-0.02 um/us']"  # the same, and cells stay on the substrate
ROLLS = "cells.0.velocity=['3 um/us', '-0.5*z um/us', '0 um/us']"
TURNING = ('materials.cytoplasm.zeta="2 kPa"', 'materials.cytoplasm.eta="30 pN"')
WALL = {"name": "wall", "box": LEFT, "displacement": ["0.05*y um", "free"],
        "load_curve": {"law": "sine", "period": "1 us"}}
PRESS = {"name": "press", "box": RIGHT, "pressure": "1 kPa", "load_curve": {"law": "ramp", "duration": "1 us"}}
POLAR = ('polarity.persistence="4.3 us"', "protrusion.basal=0.5", 'cells.Cell-2.push={begin="0.5 us", end="1.7 us"}')
ON_OTHERS = ("adhesion.pairs=[{cells=[['Cell-1', 'Cell-2'], 'Cell-3'], friction={coefficient='10 Pa us/um'}}]",
             'friction.coefficient="10 Pa us/um"')
OFF_OTHERS = "adhesion.pairs=[{cells=[['Cell-1', 'Cell-2'], 'Cell-3'], push=true, cutoff='1 um'}]"
SCENES = {
    "three in contact": lambda: case("two_three", "protrusion.cells=[]", FAST),
    "protrusion": lambda: case("all_protrude", ALONG),
    "polarity": lambda: case("all_protrude", ALONG, *POLAR),
    "push off neighbours": lambda: case("all_protrude", ALONG, *POLAR, OFF_OTHERS),
    "uniform, active": lambda: case("two_three", TURNING[0]),
    "frozen director": lambda: case("one_cell", *TURNING, 'director.law="frozen"',
                                       'director.start="radial"', FAST),
    "relaxing director": lambda: case("director_radial", *TURNING),
    "cortex and friction": lambda: case("one_cell", 'cortex.line_tension="500 pN/um"',
                                        'friction.coefficient="30 Pa us/um"'),
    "friction of cells": lambda: case("two_three", "protrusion.cells=[]", FAST, *ON_OTHERS),
    "friction in space": lambda: case("ball", 'friction.coefficient="1 kPa us/um"', ROLLS, per_cell=60),
    "network": lambda: case("two_three", "protrusion.cells=[]", FAST, *NETWORK),
    "medium": lambda: case("one_cell", 'medium.viscosity="50 mPa s"', FAST),
    "elastic": lambda: case("nucleus"),
    "supports and loads": lambda: piece(supports=[WALL], loads=[PRESS]),
    "plates": lambda: piece(plates=[plate("top", 2.0, -1.0, -0.2), plate("bottom", 0.0, 1.0, 0.2)]),
}


def end(sim, times):
    """What a simulation comes to: its bits, rows of both tables, and what it has counted."""
    rows = []
    for time in times:
        sim.go(time)
        found, entries = sim.sample()
        rows.append((repr(sim.next_row(found)), found, entries))  # means of the first row are no numbers
    return [sim.state_hash(), rows, *as_a_file_has_it(sim.integrator.saved(), sim.mechanics.segments.renewals)]


def as_a_file_has_it(*about):
    """Through JSON."""
    return json.loads(json.dumps(about))


@pytest.mark.parametrize("prune", [True, False], ids=["pruned", "whole"])
@pytest.mark.parametrize("name", SCENES)
def test_a_state_saved_between_steps_or_just_before_a_sample_goes_on_with_the_same_bits(name, prune, monkeypatch):
    monkeypatch.setattr("cellmig.solve.integrate.BATCH", 30)
    kept = {}  # the first state between 1 and 2 µs, and that at 2 µs

    def save(time):
        if 1.0 < time <= 2.0 and (time < 2.0) not in kept:
            kept[time < 2.0] = time, *sim.saved()

    with built(SCENES[name](), prune=prune) as sim:
        sim.integrator.after_batch = save
        first, later = 1.0, (2.0, 2.5)
        end(sim, [first])
        expected = end(sim, later)
    assert kept.keys() == {True, False}
    for time, about, arrays in kept.values() if prune else [kept[True]]:
        (about,), arrays = as_a_file_has_it(about), broadcast(COMM, arrays)
        for comm in ALONE_TOO:
            with built(SCENES[name](), comm, prune) as again:
                again.restore(about, arrays)
                assert again.time == time
                assert end(again, later) == expected


AT_SAMPLES = {
    "rk": lambda: case("two_three", FAST, 'time.integrator="rk"', 'time.step="2 ns"'),
    "rk with a relaxing director": lambda: case("director_radial", *TURNING, 'time.integrator="rk"'),
    "rk with a network": lambda: case("one_cell", *NETWORK, 'time.integrator="rk"'),
    "beuler with a network": lambda: case("one_cell", *NETWORK, 'time.integrator="beuler"', 'time.step="10 ns"'),
    "supports under euler": lambda: piece(supports=[WALL], loads=[PRESS], integrator="euler", step="1 ns"),
    "static, bent": lambda: bent(200),
    "static, bent in space": lambda: bent(100, 50.0, dimension=3),
    "static, a ball between plates": lambda: squeezed(60, 0.1, dimension=3),
    "static, between plates": lambda: squeezed(200, supports=[{"name": "axis", "box": MIDDLE}]),
}
MIDDLE = [["-0.2 um", "-0.2 um"], ["0.2 um", "1.5 um"]]


@pytest.mark.parametrize("name", AT_SAMPLES)
def test_where_a_state_can_be_saved_at_samples_alone_it_goes_on_with_the_same_bits_from_there(name):
    first, later = 0.2, (0.3, 0.45, 0.6)
    solved = "static" in name or "beuler" in name  # on several ranks MUMPS adds in the order of arrival
    comm = MPI.COMM_SELF if solved else COMM
    with built(AT_SAMPLES[name](), comm) as sim:
        assert not sim.integrator.between_samples
        end(sim, [first])
        about, arrays = sim.saved()
        expected = end(sim, later)
    (about,), arrays = as_a_file_has_it(about), broadcast(comm, arrays)
    with built(AT_SAMPLES[name](), comm) as again:
        again.restore(about, arrays)
        assert again.time == first
        found = end(again, later)
    assert found == expected
