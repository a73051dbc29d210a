"""Spheres of one layer, closed or open, whose mass balance is solved."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from mpi4py import MPI

import numpy as np

from opticcup_fem.equilibrium.transport import surface_balance
from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.profile import ClosedSphere, OpenCap
from opticcup_fem.meridian.shell import MeridianShell
from opticcup_fem.meridian.transport import meridian_balance
from opticcup_fem.mesh import cup_mesh, open_cap_mesh
from opticcup_fem.shell.balance import BalanceLaw, Geometry, LayerBalance, MassBalance
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.section import Layer, Section

WALL = Section([Layer("wall", 0.1, 1.0, 0.45, 3)])
LAWS = {"wall": LinearGrowth(0.0)}


class Sphere:
    """The balance of a sphere."""

    def __init__(self, balance: MassBalance) -> None:
        """Take the balance, before any growth."""
        self.balance = balance
        self.start = balance.geometry["wall"]

    @property
    def layer(self) -> LayerBalance:
        return self.balance.layers["wall"]

    @property
    def x(self) -> np.ndarray:
        return self.layer.sites.points.x

    def rest(self, radius: float = 1.0, thickness: float = 1.0) -> Mapping[str, Geometry]:
        """Where the layer is on a sphere of another radius."""
        one = self.start
        return {"wall": Geometry(radius * one.stretch, thickness * one.thickness)}

    def begin(self, mass: np.ndarray) -> None:
        """Go back to t_n = 0 with a mass per initial mass."""
        balance = self.balance
        balance.t_n, balance.past, balance.geometry = 0.0, [], self.rest()
        balance.mass["wall"] = mass
        balance.forget()

    def advance(
        self, t_end: float, steps: int, radius: Callable[[float], float] = lambda t: 1.0
    ) -> np.ndarray:
        """Return M at ``t_end`` after equal steps on spheres of a radius that changes."""
        for k in range(1, steps + 1):
            t_n = k * t_end / steps
            self.balance.commit(t_n, self.rest(radius(t_n)))
        return self.balance.mass["wall"]


def surface_sphere(law: BalanceLaw, size: float, comm: MPI.Intracomm = MPI.COMM_SELF) -> Sphere:
    """A triangulated sphere."""
    mesh = cup_mesh(math.radians(60), size, size, size, comm=comm)
    shell = Shell(mesh, {"cap": WALL, "oov": WALL}, LAWS)
    return Sphere(surface_balance(shell, {"wall": law}))


def meridian_sphere(law: BalanceLaw, size: float) -> Sphere:
    """A meridian of a sphere."""
    grading = Grading(size, at_interface=size, at_rim=size)
    mesh = MeridianMesh(ClosedSphere(math.radians(60)), grading)
    shell = MeridianShell(mesh, {"cap": WALL, "oov": WALL}, LAWS)
    return Sphere(meridian_balance(shell, {"wall": law}))


def surface_cap(law: BalanceLaw, size: float) -> Sphere:
    """A triangulated cap of 60 degrees with an edge."""
    mesh = open_cap_mesh(math.radians(60), size, size, comm=MPI.COMM_SELF)
    return Sphere(surface_balance(Shell(mesh, {"cap": WALL}, LAWS), {"wall": law}))


def meridian_cap(law: BalanceLaw, size: float) -> Sphere:
    """A meridian of a cap of 60 degrees with an edge."""
    mesh = MeridianMesh(OpenCap(math.radians(60)), Grading(size, at_interface=size, at_rim=size))
    return Sphere(meridian_balance(MeridianShell(mesh, {"cap": WALL}, LAWS), {"wall": law}))
