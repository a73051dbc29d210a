"""Grow any shell: mesh, layers, growth, supports and loads of one's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from opticcup_fem.equilibrium.jumps import make_relaxation
from opticcup_fem.equilibrium.newton import WANDERING, MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.steps import StepControl
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.supports import Mask


def grow(
    shell: Shell,
    held: Mask,
    t_end: float = 1.0,
    times: Sequence[float] = (),
    *,
    control: StepControl | None = None,
    tolerance: float = 1e-8,
    max_iterations: int = 15,
    wandering: float = WANDERING,
) -> Iterator[PathPoint]:
    """Yield stable equilibria of a shell from its rest at t_n = 0 to ``t_end`` (collective).

    Where stability is lost it relaxes onto the next stable state, which has ``jump`` set.
    Quantities of a point are to be taken before the next one is asked for: the shell's growth is
    that of the last point.

    Args:
        shell: The shell.
        held: Unknowns that are held, see ``shell.supports``: the six rigid motions at least.
        t_end: Last normalised time.
        times: Normalised times to land on exactly.
        control: Steps in t_n.
        tolerance: Newton's absolute tolerance on the residual, unit stress times length squared.
        max_iterations: Newton iterations after which a step is cut.
        wandering: See ``MixedNewton``; ``inf`` for large rotations under dead loads.

    Raises:
        ClosureBreakdown: A layer's kinematics broke down.
        ConvergenceError: The path could not be followed to its end.
    """
    problem = Problem(shell, held)
    newton = MixedNewton(problem, tolerance, max_iterations, wandering)
    relaxation = make_relaxation(problem, newton)
    stepping = LoadStepping(problem, newton, relaxation, control or StepControl())
    yield from stepping.follow(shell.reference_state(), t_end, times)
    failure = stepping.failure()
    if failure is not None:
        raise failure
