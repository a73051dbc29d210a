r"""Element tensors of the mixed shell and their exact condensation to (r, alpha).

On a cell the four-field Newton system in (dr, dalpha, dkappa, dsigma) has the mass matrix
d I (d = |det J|) between kappa and sigma, so that both are eliminated by division:

    dkappa = (L/d - kappa) + B/d du,      dsigma = (Fk + Kkr dr + Kkk dkappa)/d - sigma,

and what is left for u = (r, alpha), with b = B/d and k_0 = L/d - kappa, is

    G = (Fr, 0) + (Krk k_0, 0) + b^T (Fk + Kkk k_0),
    H = Krr + Krk b + b^T Kkr + b^T Kkk b + d^2 <sigma, L>.

Its iterates are those of the uncondensed system.  External work depends on u alone: its derivatives
are subtracted from G and H.  At a solution of the local equations H is the
Hessian of the energy as a function of (r, alpha) alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.shell.kernels import Kernel

Array = NDArray[np.float64]
CellData = Mapping[ufl.Coefficient, Array]


class Work(Protocol):
    """External work as a function of the unknowns, cell by cell."""

    def gradient(self, data: CellData) -> Array:
        """Return its first derivative, shape (n_cells, n_u)."""
        ...

    def tangent(self, data: CellData) -> Array:
        """Return its second derivative in r, shape (n_cells, n_r, n_r)."""
        ...


@dataclass(frozen=True)
class CondensedCells:
    """Condensed element systems of all cells of a rank, n_u unknowns (r, alpha) each.

    Attributes:
        gradient: G, shape (n_cells, n_u).
        kappa_0: k_0 = L/d - kappa, shape (n_cells, n_k).
        slope: b = B/d, shape (n_cells, n_k, n_u).
        bending: Fk, shape (n_cells, n_k).
        k_rk: Krk, shape (n_cells, n_r, n_k).
        k_kk: Kkk, shape (n_cells, n_k, n_k).
        det_j: d, shape (n_cells,).
        kernels: The compiled blocks, for what is tabulated only when asked for.
        data: Their coefficients.
        symmetric: Whether the tangent of the resultants is symmetric, so that Kkr = Krk^T.
        external: The loads, where there are any.
    """

    gradient: Array
    kappa_0: Array
    slope: Array
    bending: Array
    k_rk: Array
    k_kk: Array
    det_j: Array
    kernels: Mapping[str, Kernel]
    data: CellData
    symmetric: bool
    external: Work | None

    @cached_property
    def k_kr(self) -> Array:
        """Kkr, shape (n_cells, n_k, n_r)."""
        return self.k_rk.transpose(0, 2, 1) if self.symmetric else self.kernels["Kkr"](self.data)

    @cached_property
    def hessian(self) -> Array:
        """H, shape (n_cells, n_u, n_u), tabulated at the first use."""
        kernels, data, slope = self.kernels, self.data, self.slope
        n_r = self.k_rk.shape[1]
        slope_t = slope.transpose(0, 2, 1)
        hessian = slope_t @ (self.k_kk @ slope)
        hessian[:, :n_r] += self.k_rk @ slope
        hessian[:, :, :n_r] += slope_t @ self.k_kr
        in_r = kernels["Krr"](data)
        kernels["G"](data, into=in_r)
        kernels["G_edge"](data, into=in_r)
        hessian[:, :n_r, :n_r] += in_r
        mixed = kernels["Ga_edge"](data).reshape(len(self.det_j), -1, n_r)
        hessian[:, n_r:, :n_r] += mixed
        hessian[:, :n_r, n_r:] += mixed.transpose(0, 2, 1)
        if "Gaa_edge" in kernels:
            ends = np.arange(n_r, hessian.shape[1])
            hessian[:, ends, ends] += kernels["Gaa_edge"](data).reshape(len(self.det_j), -1)
        if self.external is not None:
            hessian[:, :n_r, :n_r] -= self.external.tangent(data)
        return hessian

    def local_update(self, du: Array, sigma: Array, fraction: float) -> tuple[Array, Array]:
        """Return the steps (dkappa, dsigma) that belong to the step du = fraction * (full step).

        Args:
            du: Step of the cells' unknowns, shape (n_cells, n_u).
            sigma: Multiplier before the step, shape (n_cells, n_k).
            fraction: Fraction of the Newton step that ``du`` is.
        """
        n_r = self.k_kr.shape[2]
        dkappa = fraction * self.kappa_0 + np.einsum("cku,cu->ck", self.slope, du)
        dsigma = fraction * self.bending
        dsigma = dsigma + np.einsum("ckr,cr->ck", self.k_kr, du[:, :n_r])
        dsigma = dsigma + np.einsum("ckl,cl->ck", self.k_kk, dkappa)
        return dkappa, dsigma / self.det_j[:, None] - fraction * sigma

    def local_residual(self, sigma: Array) -> tuple[Array, Array]:
        """Return the residuals of the local equations, L - d kappa and Fk - d sigma."""
        d = self.det_j[:, None]
        return d * self.kappa_0, self.bending - d * sigma


def curvature_functional(kernels: Mapping[str, Kernel], data: CellData) -> Array:
    """Return L, shape (n_cells, n_k): kappa = L/d is the curvature of (r, alpha)."""
    return kernels["L_edge"](data, into=kernels["L"](data))


def curvature_slope(kernels: Mapping[str, Kernel], data: CellData) -> Array:
    """Return B = dL/d(r, alpha), shape (n_cells, n_k, n_u)."""
    in_r = kernels["B_edge"](data, into=kernels["B"](data))
    in_alpha = kernels["Ba_edge"](data)
    return np.concatenate([in_r, *np.moveaxis(in_alpha, 1, 0)], axis=-1)


def condensed_gradient(
    kernels: Mapping[str, Kernel], data: CellData, det_j: Array, external: Work | None
) -> Array:
    """Return the gradient (Fr, 0) + b^T Fk of the energy at kappa = L/d, shape (n_cells, n_u).

    The gradient of the loads' work is subtracted.
    """
    slope = curvature_slope(kernels, data)
    gradient = np.einsum("cku,ck->cu", slope, kernels["Fk"](data) / det_j[:, None])
    in_r = kernels["Fr"](data)
    gradient[:, : in_r.shape[1]] += in_r
    return gradient if external is None else gradient - external.gradient(data)


def condense(
    kernels: Mapping[str, Kernel],
    data: CellData,
    det_j: Array,
    kappa: Array,
    symmetric: bool,
    external: Work | None = None,
) -> CondensedCells:
    """Tabulate and condense all cells.

    Args:
        kernels: The compiled blocks of ``ShellForms``.
        data: Coefficients (position, sigma, angles, resultants ...).
        det_j: |det J|, shape (n_cells,).
        kappa: Curvature state, shape (n_cells, n_k).
        symmetric: Whether the tangent of the resultants is symmetric.
        external: The loads, if any.
    """
    d = det_j[:, None]
    kappa_0 = curvature_functional(kernels, data) / d - kappa
    slope = curvature_slope(kernels, data) / d[:, :, None]
    force, bending = kernels["Fr"](data), kernels["Fk"](data)
    k_rk, k_kk = kernels["Krk"](data), kernels["Kkk"](data)
    moved = bending + np.einsum("ckl,cl->ck", k_kk, kappa_0)
    gradient = np.einsum("cku,ck->cu", slope, moved)
    gradient[:, : force.shape[1]] += force + np.einsum("crk,ck->cr", k_rk, kappa_0)
    if external is not None:
        gradient -= external.gradient(data)
    return CondensedCells(
        gradient, kappa_0, slope, bending, k_rk, k_kk, det_j, kernels, data, symmetric, external
    )
