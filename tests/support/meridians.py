"""Small axisymmetric shells for the tests of the meridian model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.problem import MeridianProblem
from opticcup_fem.meridian.profile import ClosedSphere, Disc, OpenCap, Profile
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.section import Layer, Section

COARSE = Grading(largest=0.25, at_interface=0.04, at_rim=0.1, growth=2.0)
LAWS = {"iov": LinearGrowth(5.0), "ecm": LinearGrowth(0.0), "oov": LinearGrowth(1.5)}
PROFILES: dict[str, Profile] = {
    "closed": ClosedSphere(math.radians(40)),
    "open": OpenCap(math.radians(60)),
    "disc": Disc(1.0),
}


def bilayer(h: float) -> Section:
    """Return the section of the cap: IOV inside, ECM outside."""
    return Section([Layer("iov", 0.9 * h, 1.0, 0.45, 5), Layer("ecm", 0.1 * h, 50.0, 0.45, 2)])


def shell_on(
    profile: Profile, h: float = 0.1, grading: Grading = COARSE, closure: str = "layer-stretch"
) -> MeridianShell:
    """Return a grown bilayer on a profile, with an OOV where the profile has one."""
    sections = {"cap": bilayer(h), "oov": Section([Layer("oov", h, 1.0, 0.45, 5)])}
    mesh = MeridianMesh(profile, grading)
    return MeridianShell(mesh, {name: sections[name] for name in mesh.region}, LAWS, closure)


def in_local_equilibrium(
    problem: MeridianProblem, state: MeridianState, t_n: float
) -> MeridianState:
    """Return the state with the curvature and the multiplier that its placement implies."""
    sizes = problem.shell.mesh.sizes[:, None]
    linear = problem.linearise(problem.pack(state), t_n)
    state = replace(state, kappa=state.kappa + linear.cells.kappa_0)
    linear = problem.linearise(problem.pack(state), t_n)
    return replace(state, sigma=linear.cells.bending / sizes)


def bent_state(shell: MeridianShell, seed: int, amount: float = 0.004) -> MeridianState:
    """Return the reference moved smoothly, vertices turned with it and a little more."""
    rng = np.random.default_rng(seed)
    state = shell.reference_state()
    s = shell.mesh.s / shell.mesh.s[-1]
    waves = np.stack([np.sin(np.pi * k * s) for k in (1, 2, 3)])
    # z is even and r odd at a pole; sin(pi k s) serves both when multiplied by s for z
    move = np.stack([rng.normal(size=3) @ waves, s * (rng.normal(size=3) @ waves)], axis=1)
    turn = rng.normal(size=shell.mesh.n_cells + 1) * ~shell.mesh.is_pole
    return replace(state, r=state.r + amount * move, angle=state.angle + 0.2 * amount * turn)
