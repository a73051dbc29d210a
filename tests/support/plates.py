"""A deep elastic cap pressed by a rigid plate: half of a sphere squeezed between two.

``python3 -m tests.support.plates docs/images/plate.png 50 100`` draws forces for some R/h,
whose tables it keeps beside the picture and reads when they are there.
"""

import csv
import math
import sys
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

from opticcup_fem.contact.model import Contact
from opticcup_fem.contact.obstacles import Plate
from opticcup_fem.contact.potential import ContactSettings
from opticcup_fem.contact.report import contact_report
from opticcup_fem.equilibrium.jumps import make_relaxation
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping, StepControl
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.mesh import open_cap_mesh
from opticcup_fem.plots import style
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.recovery import capture
from opticcup_fem.shell.supports import clamped
from tests.support.shells import wall

NU = 0.3
YOUNG = 2 * (1 + NU)
"""For mu = 1."""

DISTANCE = 0.1
"""Barrier's distance over h."""


@dataclass(frozen=True)
class Pressed:
    """One state, lengths over h.

    Attributes:
        plate: How far the plate has come beyond the outer face of the unloaded sphere.
        apex: Deflection of the apex.
        force: Of the plate, over E h^3/R.
        apex_gap: Gap between plate and apex.
        radius: Largest distance from the axis of a node that is pushed.
    """

    plate: float
    apex: float
    force: float
    apex_gap: float
    radius: float


def reissner(deflection: float) -> float:
    """Return Reissner's force over E h^3/R for a deflection of the apex over h."""
    return 4 * deflection / math.sqrt(3 * (1 - NU**2))


def boundary_layer(ratio: float) -> float:
    """Return the width sqrt(R h)/(12 (1 - nu^2))^(1/4) over R."""
    return 1 / math.sqrt(ratio) / (12 * (1 - NU**2)) ** 0.25


def pressed(ratio: float, depth: float, cell: float = 1.0, step: float = 0.04) -> list[Pressed]:
    """Return the states of a cap of eight boundary layers, its rim clamped, under a plate.

    Args:
        ratio: R/h.
        depth: How far the plate comes, over h.
        cell: Size of the cells over the boundary layer's width.
        step: Largest step over the depth.
    """
    h, layer = 1 / ratio, boundary_layer(ratio)
    mesh = open_cap_mesh(8.5 * layer, cell * layer, 1.5 * cell * layer, comm=MPI.COMM_SELF)
    shell = Shell(mesh, {"cap": wall(h, NU)}, {"wall": LinearGrowth(0.0)})
    gap = 1.05 * DISTANCE * h
    top, way = 1 + h / 2, depth * h + gap
    plate = Plate((0, 0, top + gap), (0, 0, 1), 4.0, velocity=(0, 0, -way))
    settings = ContactSettings(DISTANCE * h, 100 * h * h)
    problem = Problem(shell, clamped(shell, "rim"), Contact(shell, settings, [plate]))
    newton = MixedNewton(problem, tolerance=1e-10)
    control = StepControl(initial=step / 8, largest=step, smallest=1e-4)
    stepping = LoadStepping(problem, newton, make_relaxation(problem, newton), control)
    found = []
    for point in stepping.follow(shell.reference_state(), 1.0):
        snapshot = capture(shell, point.state, point.t_n)
        report = contact_report(problem.contact, point.state)
        apex = int(np.argmin(np.hypot(snapshot.reference[:, 0], snapshot.reference[:, 1])))
        height = top + gap - way * point.t_n
        at_apex = np.argwhere(snapshot.cells == apex)
        outer = np.mean([snapshot.faces["cap"][c, k, -1, 2] for c, k in at_apex])
        sizes = np.linalg.norm(report.forces, axis=1)
        pushed = sizes > 1e-2 * sizes.max(initial=0.0)
        radii = np.hypot(snapshot.position[:, 0], snapshot.position[:, 1])
        found.append(
            Pressed(
                (top - height) / h,
                (1 - snapshot.position[apex, 2]) / h,
                -report.forces[:, 2].sum() / (YOUNG * h**3),
                (height - outer) / h,
                float(radii[pushed].max(initial=0.0)) / h,
            )
        )
    if (failure := stepping.failure()) is not None:
        raise failure
    return found


def table(path: Path, ratio: float) -> list[Pressed]:
    """Return the states of a ratio to a depth of 3.5 thicknesses, from a table if it exists."""
    if not path.exists():
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([field.name for field in fields(Pressed)])
            writer.writerows(astuple(row) for row in pressed(ratio, 3.5))
    with path.open(newline="") as file:
        return [Pressed(*map(float, row.values())) for row in csv.DictReader(file)]


@style.styled
def draw(out: Path, ratios: list[float]) -> None:
    """Draw force and gap at the apex over the way of the plate."""
    figure = Figure(figsize=(8.4, 3.4), layout="constrained")
    forces, gaps = figure.subplots(1, 2)
    for ratio, colour in zip(ratios, style.CURVES, strict=False):
        rows = table(out.with_name(f"{out.stem}-{ratio:g}.csv"), ratio)
        plate, _, force, gap, _ = np.array([astuple(row) for row in rows]).T
        forces.plot(plate, force, ".-", color=colour, label=f"$R/h$ = {ratio:g}")
        gaps.plot(plate, gap, ".-", color=colour, label=f"$R/h$ = {ratio:g}")
    line = np.array([0.0, 2.2])
    forces.plot(line, reissner(1.0) * line, "--", color=style.REFERENCE, label="Reissner")
    forces.set(xlabel="way of the plate ($h$)", ylabel="force ($E h^3/R$)", xlim=(0, 3.5))
    gaps.set(xlabel="way of the plate ($h$)", ylabel="gap at the apex ($h$)", xlim=(0, 3.5))
    forces.legend()
    style.save(figure, out)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), [float(ratio) for ratio in sys.argv[2:]])
