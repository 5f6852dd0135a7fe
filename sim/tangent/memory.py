"""Muscles remember a motion: contraction that is lent and friction, by the laws of effects on a muscle's bench, which
see the contraction of each interval along the motion as a record."""

from collections.abc import Hashable
from functools import cached_property

import numpy as np
import taichi as ti

from fabdesign.effects.acting import active, muscles_of
from fabdesign.effects.declaration import MuscleRecord, Specimen
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Course
from fabdesign.nouns.forward import Case
from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.kernels.vectors import Lanes
from sim.lacing import touched
from sim.state import LOADED, Plane
from sim.tangent.muscle_forces import Grid, contractions, offset_of


@ti.func
def _lent(b, k):
    return F.point[b, X.held_lent + k], Lanes(0.0)


@ti.func
def _friction(b, k):
    return -F.point[b, X.held_friction + k], Lanes(0.0)


REMEMBERED = AddedForce(
    lent=_lent,
    tension=_friction,
    planes=(
        Plane("held_lent", "interval", "1", LOADED, "contraction lent, where a shape is held in balance"),
        Plane("held_friction", "interval", "N", LOADED, "friction there, against contraction"),
    ),
)


class Memory:
    """The memory of a specimen's muscles along a course, under the effects of any case. pressure: (ticks, channels) Pa,
    ticks of `tick` s from rest on."""

    def __init__(self, specimen: Specimen, course: Course, pressure: Array, tick: float) -> None:
        self._specimen, self._course, self._pressure, self.tick = specimen, course, pressure, tick
        self._known: dict[Hashable, list[MuscleRecord]] = {}

    def of(self, case: Case) -> list[MuscleRecord]:
        """Return what each muscle has felt; nothing where no effect is remembered."""
        acting = [(effect, values, term) for effect, values, term in active(case) if effect.pulls_by_record]
        key = tuple((term.name, term.scope, *values.items()) for _, values, term in acting)
        if key not in self._known:
            records = self._records if acting else []
            for effect, values, term in acting:
                assert effect.bench is not None
                records = [
                    effect.bench(record, values) if acts else record
                    for record, acts in zip(records, muscles_of(case, term), strict=True)
                ]
            self._known[key] = records
        return self._known[key]

    @cached_property
    def _records(self) -> list[MuscleRecord]:
        time, middle, design = self._course.time, self._course.middle, self._specimen.design
        n, shapes = middle.shape[1], middle.reshape(len(time), -1, 3).astype(float)
        spacing = np.array([design.fabric.width, design.fabric.height]) / (n - 1)
        ticks = np.minimum(np.round(time / self.tick).astype(int), len(self._pressure) - 1)
        kinds = design.muscle_types
        levers, grid = self._specimen.muscles["lever"].tolist(), Grid(n, *touched(design, n))
        return [
            MuscleRecord.measured(
                time,
                self._pressure[ticks, muscle.channel][:, None],
                contractions(muscle, offset_of(muscle, kinds[muscle.type], lever), shapes, spacing, grid),
            )
            for muscle, lever in zip(design.muscles, levers, strict=True)
        ]


def felt(record: MuscleRecord, time: float) -> tuple[Array, Array]:
    """Return contraction lent and N of friction at an instant, (k,) each, between the rows of a record."""
    row = int(np.clip(np.searchsorted(record.time, time), 1, len(record.time) - 1))
    before, after = record.time[row - 1 : row + 1]
    share = np.clip((time - before) / (after - before), 0.0, 1.0)
    lent, friction = ((1 - share) * of[row - 1] + share * of[row] for of in (record.lent, record.friction))
    return lent, friction
