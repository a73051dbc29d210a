"""The tangent of a path of equilibria, where its last states do not tell it: behind a kink."""

from __future__ import annotations

from dataclasses import replace

from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.transport import begin_step
from opticcup_fem.errors import UnbalancedLayer
from opticcup_fem.shell.model import ShellState


def on_tangent(problem: Problem, state: ShellState, t_n: float, dt: float) -> ShellState | None:
    """Return where the tangent of the path through an equilibrium leads (collective).

    It is one step of Newton's method at t_n + dt, with the tangent at the equilibrium, for what the
    residual gains on the way: contact data of a solution may be a little older.  The shell is left
    at t_n + dt.

    Args:
        problem: The shell's global problem.
        state: The equilibrium, stable.
        t_n: Its normalised time.
        dt: A short time, of either sign.

    Returns:
        None where a layer cannot be there.
    """
    shell = problem.shell
    shell.set_time(t_n)
    problem.forget_contacts()
    if problem.contact is not None:
        problem.contact.begin(state)
    start = problem.with_contact(replace(state, contact=None))
    cells = shell.condensed(start)
    problem.assemble_tangent(cells, problem.contact_stiffness(start))
    problem.factorise()
    left, step = problem.vector.duplicate(), problem.vector.duplicate()
    problem.assemble_gradient(cells, start, left)
    try:
        begin_step(shell, t_n + dt, state)
    except UnbalancedLayer:
        return None
    later = problem.with_contact(replace(state, contact=None))
    resultants, _ = shell.evaluate(later)
    if resultants is None:
        return None
    cells = shell.condensed(later, resultants)
    problem.assemble_gradient(cells, later, step)
    problem.ksp.solve(left - step, step)
    return problem.stepped(later, cells, step.array_r)
