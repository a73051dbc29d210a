"""The exceptions that opticcup_fem raises on purpose.

Every message is one sentence for people (what, where, which value, what to do); the fields are for
programs. All of them survive pickling, so that one MPI rank can send its error to the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


class OpticCupError(Exception):
    """Base of every error that this package raises on purpose."""


class CaseError(OpticCupError, ValueError):
    """A case, or a place that it names, cannot be used as it is written."""

    def __init__(self, sentence: str) -> None:
        """Keep the sentence on one line, whatever it quotes."""
        super().__init__(
            "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in sentence)
        )


class MeshError(OpticCupError):
    """A mesh could not be made, or does not fit the case."""


class RecordError(OpticCupError):
    """Results cannot be written, for example because the disk is full."""


class InterruptedRun(OpticCupError):
    """A run was asked to stop, and did after its present step."""

    def __init__(self, signal: int, t_n: float, folder: str) -> None:
        """Build the sentence from its fields.

        Args:
            signal: Number of the signal that asked.
            t_n: Normalised time of the last accepted state.
            folder: The run folder, "" where it cannot be resumed.
        """
        self.signal, self.t_n, self.folder = signal, t_n, folder
        onward = f"; go on with: opticcup run --resume {folder}" if folder else ""
        super().__init__(f"interrupted at t_n = {t_n:.6g}; everything up to there is kept{onward}")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle by fields: the default would hand the sentence to ``__init__``."""
        return type(self), (self.signal, self.t_n, self.folder)


class ConvergenceError(OpticCupError):
    """No equilibrium was found, although the step was cut as far as allowed."""

    def __init__(
        self, reason: str, t_n: float, step: int, iterations: int, residual: float
    ) -> None:
        """Build the sentence from its fields.

        Args:
            reason: What the solver gave as its reason, for example ``DIVERGED_MAX_IT``.
            t_n: Normalised time of the last accepted state.
            step: Number of the step that failed.
            iterations: Newton iterations spent in the last attempt.
            residual: Norm of the residual when it stopped.
        """
        self.reason = reason
        self.t_n = t_n
        self.step = step
        self.iterations = iterations
        self.residual = residual
        super().__init__(
            f"no equilibrium found beyond t_n = {t_n:.6g} (step {step}): {reason} after "
            f"{iterations} iterations, |r| = {residual:.2g}; everything up to there is kept; "
            "try a smaller solver.min_step or a finer mesh"
        )

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle by fields: the default would hand the sentence to ``__init__``."""
        return type(self), (self.reason, self.t_n, self.step, self.iterations, self.residual)


class ClosureBreakdown(OpticCupError):
    """A closure has no admissible thickness stretch somewhere in the shell.

    Either a fibre is turned inside out (its metric lost positive determinant) or, in the `paper`
    closure, the implicit equation for lambda_3 lost its root.
    """

    def __init__(
        self,
        closure: str,
        layer: str,
        height: float,
        position: Sequence[float],
        t_n: float | None = None,
    ) -> None:
        """Build the sentence from its fields.

        Args:
            closure: Name of the closure, as in `material.closure`.
            layer: Name of the layer, for example ``"oov"``.
            height: xi of the fibre, positive outside, in the length unit of `position`.
            position: Current place of the fibre, shape (3,), in units of R for cups.
            t_n: Normalised time, or None while it is not known to whoever raises.
        """
        self.closure = closure
        self.layer = layer
        self.height = float(height)
        self.position = tuple(float(x) for x in position)
        self.t_n = t_n
        where = ", ".join(f"{x:.4g}" for x in self.position)
        when = "" if t_n is None else f" at t_n = {t_n:.6g}"
        super().__init__(
            f"the {closure} closure breaks down{when} in layer {layer} at height "
            f"xi = {self.height:.4g}, position ({where}): no admissible thickness stretch there; "
            "this limits the closure, it is not an instability of the shell"
        )

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle by fields: the default would hand the sentence to ``__init__``."""
        return type(self), (self.closure, self.layer, self.height, self.position, self.t_n)

    def at(self, t_n: float) -> ClosureBreakdown:
        """Return the same breakdown with its normalised time filled in."""
        return type(self)(self.closure, self.layer, self.height, self.position, t_n)


class UnbalancedLayer(OpticCupError):
    """The mass balance of a layer has no solution with mass everywhere."""

    def __init__(self, layer: str, what: str, position: Sequence[float], t_n: float) -> None:
        """Build the sentence from its fields.

        Args:
            layer: Name of the layer.
            what: What the balance does, a verb with its object.
            position: Place on the shell at rest, shape (3,), in units of R for cups.
            t_n: Normalised time for which it was tried.
        """
        self.layer, self.what, self.t_n = layer, what, t_n
        self.position = tuple(float(x) for x in position)
        where = ", ".join(f"{x:.4g}" for x in self.position)
        super().__init__(
            f"the mass balance of layer {layer} {what} at t_n = {t_n:.6g}, at rest at ({where}); "
            f"everything up to there is kept; look at mass.{layer}.source"
        )

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle by fields: the default would hand the sentence to ``__init__``."""
        return type(self), (self.layer, self.what, self.position, self.t_n)
