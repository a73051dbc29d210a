"""Which relaxation fits a problem."""

from __future__ import annotations

from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.relaxation import EnergyDescent
from opticcup_fem.equilibrium.viscous import ViscousRelaxation

Relaxation = EnergyDescent | ViscousRelaxation


def make_relaxation(problem: Problem, newton: MixedNewton) -> Relaxation:
    """Return energy descent where the closure has an energy, viscous flow where it has none."""
    if problem.symmetric:
        return EnergyDescent(problem, newton.tolerance)
    return ViscousRelaxation(problem, newton)
