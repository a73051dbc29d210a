"""How many eigenvalues of the tangent are negative, exactly for every closure.

A symmetric tangent tells by the inertia of its factor.  Closures without an energy have a tangent
that is not symmetric: where its symmetric part is positive definite, all eigenvalues have positive
real parts; where not, that may be a false alarm, and the eigenvalues near zero decide.
"""

from __future__ import annotations

from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.spectrum import Spectrum
from opticcup_fem.errors import ConvergenceError
from opticcup_fem.shell.model import ShellState

MARGIN = 6
"""Eigenvalues sought beyond as many as the symmetric part has negative ones."""


class NegativeEigenvalues:
    """Counts the negative eigenvalues at solutions of Newton's method."""

    def __init__(self, newton: MixedNewton, spectrum: Spectrum | None = None) -> None:
        """Keep the parts.

        Args:
            newton: Solver of the states.
            spectrum: Eigenvalues of the shell's states; by default those of the shell held as the
                solver's problem is, made when they are first needed.
        """
        self.newton, self._spectrum = newton, spectrum

    def at_solution(self, state: ShellState) -> int | None:
        """Return their number at the solver's last solution (collective).

        Args:
            state: That solution, on whichever directors.

        Returns:
            How many eigenvalues have a negative real part; None if that is not known, because
            they had to be computed and the eigensolver failed.
        """
        inertia, problem = self.newton.inertia(), self.newton.problem
        if inertia is None or problem.symmetric or inertia.negative == 0:
            return None if inertia is None else inertia.negative
        if self._spectrum is None:
            self._spectrum = Spectrum(
                problem.shell, problem.unknowns.held, problem.unknowns.mirrors
            )
        try:
            modes = self._spectrum.modes(state, inertia.negative + MARGIN)
        except ConvergenceError:
            return None
        return sum(mode.eigenvalue < 0 for mode in modes)
