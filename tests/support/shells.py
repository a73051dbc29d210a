"""Small shells for the tests of the shell, and a plain way to load them."""

import math
from collections.abc import Sequence
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.mesh import SurfaceMesh, cup_mesh, strip_mesh
from opticcup_fem.shell.growth import GrowthLaw, LinearGrowth
from opticcup_fem.shell.loads import Load
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.section import Layer, Section
from opticcup_fem.shell.supports import Mask

Array = npt.NDArray[np.float64]
COMM = MPI.COMM_SELF
ALPHA = math.radians(40.0)
ENERGY_CLOSURES = ("layer-stretch", "condensed")
OTHER_CLOSURES = ("paper", "closed-form")
RATES = {"iov": 5.0, "ecm": 0.0, "oov": 1.5}


def wall(thickness: float = 0.2, poisson_ratio: float = 0.45, points: int = 5) -> Section:
    """One layer, "wall", of unit shear modulus."""
    return Section([Layer("wall", thickness, 1.0, poisson_ratio, points)])


def coarse_cup(factor: float = 1.0) -> SurfaceMesh:
    """A cup of 126 cells, or one whose cells are smaller by ``factor``."""
    return cup_mesh(ALPHA, factor * 0.45, factor * 0.3, factor * 0.6, comm=COMM)


def sphere_shell(
    section: Section,
    rate: float = 0.0,
    closure: str = "layer-stretch",
    factor: float = 1.0,
    loads: Sequence[Load] = (),
) -> Shell:
    """A closed unit sphere with one section everywhere; all its layers grow alike."""
    laws = {layer.name: LinearGrowth(rate) for layer in section.layers}
    sections = {"cap": section, "oov": section}
    return Shell(coarse_cup(factor), sections, laws, closure, loads=loads)


def cup_sections(thickness: float = 0.2, poisson_ratio: float = 0.45) -> dict[str, Section]:
    """The chick's sections at R/h = 1/thickness: cap (IOV inside, ECM outside) and OOV."""
    iov = Layer("iov", 0.9 * thickness, 1.0, poisson_ratio, 5)
    ecm = Layer("ecm", 0.1 * thickness, 50.0, poisson_ratio, 2)
    oov = Layer("oov", thickness, 1.0, poisson_ratio, 5)
    return {"cap": Section([iov, ecm]), "oov": Section([oov])}


def cup_shell(closure: str = "layer-stretch", loads: Sequence[Load] = ()) -> Shell:
    """The coarse chick cup."""
    laws: dict[str, GrowthLaw] = {name: LinearGrowth(rate) for name, rate in RATES.items()}
    return Shell(coarse_cup(), cup_sections(), laws, closure, loads=loads)


def strip_shell(
    section: Section, width: float, along: int, across: int, loads: Sequence[Load] = ()
) -> Shell:
    """A flat strip of unit length along x that does not grow."""
    mesh = strip_mesh(1.0, width, along, across, comm=COMM)
    laws = {layer.name: LinearGrowth(0.0) for layer in section.layers}
    return Shell(mesh, {"strip": section}, laws, loads=loads)


def disturbed(shell: Shell, size: float, seed: int = 0) -> ShellState:
    """The reference state with random positions and angles, in local equilibrium."""
    rng = np.random.default_rng(seed)
    state = shell.reference_state()
    return shell.with_local_equilibrium(
        replace(
            state,
            r=state.r + size * rng.normal(size=state.r.shape),
            alpha=state.alpha + size * rng.normal(size=state.alpha.shape),
        )
    )


def moved(state: ShellState, positions: Array, angles: Array) -> ShellState:
    """The state with other positions and angles; curvature and moments stay."""
    return replace(state, r=state.r + positions, alpha=state.alpha + angles)


def loaded(
    shell: Shell, held: Mask, steps: int, tolerance: float = 1e-10, most: int = 12
) -> tuple[ShellState, list[int], Problem]:
    """Load a shell from t_n = 0 to 1 in equal steps, each starting at the last state.

    Newton's guard against wandering is off: large rotations under dead loads raise residuals.

    Returns:
        The last state, the Newton iterations of the steps, and the problem, whose matrix is
        factorised near the last state.
    """
    problem = Problem(shell, held)
    newton = MixedNewton(problem, tolerance, most, wandering=np.inf)
    state, iterations = shell.reference_state(), []
    for step in range(1, steps + 1):
        shell.set_time(step / steps)
        solution = newton.solve(state)
        assert solution.converged, f"step {step}: {solution.reason}, |r| = {solution.residual:.2g}"
        iterations.append(solution.iterations)
        state = shell.with_updated_directors(solution.state)
    return state, iterations, problem


def rate_of(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Fitted order of convergence: the slope of log(error) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
