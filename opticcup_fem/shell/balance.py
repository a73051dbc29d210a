r"""Mass balance (S9) of the layers of a shell that deforms.

Of a layer of thickness H at rest, with J = sqrt(det a/det a_ref) <lambda_3>, the ratio of its
present to its first volume (no shifter, as in the energy; <lambda_3> is the layer's mean), the mass
per initial mass is M = J rho/rho_0 and (S9) reads, for all w on the layer,

    d/dt int H M w dA_ref = int H J S w dA_ref - int H J D grad rho . grad w dA_ref
                            - int H q w dS_ref

with grad on the present mid-surface, grad rho . grad w = a^ab rho,_a w,_b, and q the mass that
leaves through the layer's edge, per area of the edge at rest.  All densities are over rho_0.

Without flux the balance holds point by point, dM/dt = J S, and M is a number at every quadrature
point.  With flux, rho is a continuous Lagrange field and M = J rho.  Both are integrated by the
two-stage Radau IIA method (order 3; L-stable): whatever M(t), it is found exactly if it is a
polynomial of degree 2.  Between the ends of a step, the right stretch U of the mid-surface
(U^2 = a) and <lambda_3> go linearly.  With w = 1 the step conserves mass to rounding, whatever the
shell does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import UnbalancedLayer
from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.shell.growth import SurfacePoints, UnevenLayer
from opticcup_fem.stimulus import Stimulus

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STAGES = (1 / 3, 1.0)
RADAU = np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])
"""Nodes and coefficients of the two-stage Radau IIA method; its last stage is the end."""

SAME_TIME = 1e-13
DIFFERENCE = 1e-6
"""Relative step of the central difference of a source in rho."""

DEPTH = 5
"""Turns between growth and deformation that the next one is extrapolated from."""

MIXED_NEAR = 1e-3
"""Times this near share what is added to the growth of a trial."""

SAME_TURN = 1e-6
"""Times this near, among which a continuation closes in on one, are those of one acceleration."""

CONVERGED = 1e-12
"""Relative change of M or rho that ends Newton's method."""

SAME_SLOPE = 1e-4
"""Change of dS/d rho, in 1 per unit of t_n, for which a factorisation serves once more."""

MOST_ITERATIONS = 25


@dataclass(frozen=True)
class BalanceLaw:
    """What changes the mass of a layer, and what that does to it.

    Attributes:
        stimulus: (S10) and (S12).
        source: S(t_n, points, rho) per volume, in rho_0 per unit of t_n, shape (n,) or ().
        diffusivity: D(t_n, points) >= 0, likewise; None for no flux.
        edge_flux: q(t_n, places (n, 3)) through the layer's edge; None for none.
    """

    stimulus: Stimulus
    source: Callable[[float, SurfacePoints, Array], Array]
    diffusivity: Callable[[float, SurfacePoints], Array] | None = None
    edge_flux: Callable[[float, Array], Array] | None = None


class Geometry(NamedTuple):
    """Where a layer is, at the quadrature points of its cells.

    Attributes:
        stretch: (11, 22, 12) of U in the cells' frames, U^2 = a, shape (n, 3).
        thickness: Mean of lambda_3 through the layer, shape (n,).
    """

    stretch: Array
    thickness: Array

    def towards(self, other: Geometry, share: float) -> Geometry:
        """Return the geometry at a share of the way to another."""
        return Geometry(*((1 - share) * a + share * b for a, b in zip(self, other, strict=True)))


def root_of_metric(a: Array) -> Array:
    """Return U, U^2 = a, of (11, 22, 12) components (n, 3) in orthonormal frames."""
    determinant = np.sqrt(a[:, 0] * a[:, 1] - a[:, 2] ** 2)
    trace = np.sqrt(a[:, 0] + a[:, 1] + 2 * determinant)
    root: Array = (a + determinant[:, None] * np.array([1.0, 1.0, 0.0])) / trace[:, None]
    return root


class FluxSystem(Protocol):
    """The Lagrange field of a layer's density: cell integrals, and the solution of a system."""

    @property
    def basis(self) -> Array:
        """Basis at the quadrature points, broadcastable to (n_cells, n_points, n_nodes)."""
        ...

    def capacity(self, values: Array) -> Array:
        """Return int values u w dx, (n_cells, n_nodes, n_nodes); values (n_cells, n_points)."""
        ...

    def conduction(self, values: Array) -> Array:
        """Return int K^ab u,_a w,_b dx for K (11, 22, 12), (n_cells, n_points, 3)."""
        ...

    def load(self, values: Array) -> Array:
        """Return int values w dx, (n_cells, n_nodes)."""
        ...

    def edge(self, flux: Callable[[Array], Array]) -> Array:
        """Return int H flux w dS_ref over the layer's edge, (n_cells, n_nodes)."""
        ...

    def solve(self, matrices: Array | None, right: Array) -> Array:
        """Solve the sum of cell systems in two fields, the first before the second (collective).

        Args:
            matrices: Shape (n_cells, 2 n_nodes, 2 n_nodes); None for those of the last call.
            right: Shape (n_cells, 2 n_nodes).

        Returns:
            The solution on the cells, shape (n_cells, 2 n_nodes).
        """
        ...


@dataclass(frozen=True)
class LayerSites:
    """Where a layer's balance is solved: all its cells on this rank.

    Attributes:
        cells: Their numbers in the mesh, shape (m,).
        points: Their quadrature points, m q = n in all.
        n_points: q.
        density: H dA_ref over the cell's own measure dx, at the points, shape (n,).
        measure: dx of the points, shape (n,).
        area_ref: sqrt(det a_ref), shape (n,).
        comm: Communicator of the ranks that share the layer.
    """

    cells: Indices
    points: SurfacePoints
    n_points: int
    density: Array
    measure: Array
    area_ref: Array
    comm: MPI.Intracomm

    def volume_ratio(self, at: Geometry) -> Array:
        """Return J, shape (n,)."""
        U = at.stretch
        return np.asarray((U[:, 0] * U[:, 1] - U[:, 2] ** 2) / self.area_ref * at.thickness)

    def total(self, values: Array) -> float:
        """Return the integral of values (n,) over the layer's volume at rest (collective)."""
        return float(self.comm.allreduce(float(np.sum(values * self.density * self.measure))))

    def extreme(self, values: Array, which: MPI.Op) -> float:
        """Return the least or largest of values at the points (collective)."""
        mine = values.min(initial=np.inf) if which == MPI.MIN else values.max(initial=-np.inf)
        return float(self.comm.allreduce(float(mine), which))

    def per_cell(self, values: Array) -> Array:
        """Return values at the points as (m, q)."""
        n = len(self.cells) * self.n_points
        return np.broadcast_to(values, n).reshape(len(self.cells), self.n_points)


@dataclass(frozen=True)
class LayerStep:
    """A layer over one step in t_n.

    Attributes:
        start: First time.
        end: Last time.
        mass: M at the start, the first stage and the end, shape (3, n).
        nodal: rho of both stages at the nodes of the cells, shape (2, m, n_nodes), with flux.
        total: Mass of the layer at the end, on all ranks.
        error: Change of mass less what source and edge brought, over ``total``.
    """

    start: float
    end: float
    mass: Array
    nodal: Array | None
    total: float
    error: float

    def at(self, t_n: float) -> Array:
        """Return M at a time of the step, or a little beyond."""
        x = (t_n - self.start) / (self.end - self.start)
        c = STAGES[0]
        weights = np.array(
            [(x - c) * (x - 1) / c, x * (x - 1) / (c * (c - 1)), x * (x - c) / (1 - c)]
        )
        return np.asarray(weights @ self.mass)


class LayerBalance:
    """The balance of one layer, step by step.

    Attributes:
        name: The layer.
        law: What changes its mass.
        sites: Where it is solved.
        has_flux: Whether its mass moves.
        initial: Mass at t_n = 0, on all ranks.
    """

    def __init__(
        self, name: str, law: BalanceLaw, sites: LayerSites, flux: FluxSystem | None = None
    ) -> None:
        """Keep the parts; ``flux`` is there where the law has a diffusivity."""
        self.name, self.law, self.sites, self._flux = name, law, sites, flux
        self.has_flux = flux is not None
        self.initial = sites.total(np.ones(len(sites.density)))

    def step(
        self,
        span: tuple[float, float],
        mass: Array,
        ends: tuple[Geometry, Geometry],
        nodal: Array | None = None,
    ) -> LayerStep:
        """Integrate over a step (collective).

        Args:
            span: Its first and last time.
            mass: M at the start, shape (n,).
            ends: Where the layer is at both.
            nodal: rho at the nodes of the cells to start the iteration at, (m, n_nodes).

        Raises:
            UnbalancedLayer: The source leaves no mass, or a denser and denser layer.
        """
        ratios = [self.sites.volume_ratio(ends[0].towards(ends[1], c)) for c in STAGES]
        if self._flux is None:
            stages, gained = self._pointwise(span, mass, ratios)
            fields = None
        else:
            between = [ends[0].towards(ends[1], c) for c in STAGES]
            stages, gained, fields = self._conducted(span, mass, between, nodal)
        total = self.sites.total(stages[1])
        error = abs(self.sites.total(stages[1] - mass) - gained) / total
        return LayerStep(
            *span,
            np.stack([mass, *stages]),
            fields,
            total,
            error,
        )

    def _times(self, span: tuple[float, float]) -> list[float]:
        return [span[0] + c * (span[1] - span[0]) for c in STAGES]

    def _source(self, t_n: float, rho: Array) -> tuple[Array, Array]:
        """Return S and its derivative in rho at the points."""
        points, shape = self.sites.points, rho.shape
        h = DIFFERENCE * np.maximum(np.abs(rho), DIFFERENCE)
        with np.errstate(all="ignore"):  # the caller looks at what is not finite
            here, up, down = (
                np.broadcast_to(self.law.source(t_n, points, x), shape)
                for x in (rho, rho + h, rho - h)
            )
            return here, (up - down) / (2 * h)

    def _pointwise(
        self, span: tuple[float, float], mass: Array, ratios: Sequence[Array]
    ) -> tuple[Array, float]:
        """Integrate dM/dt = J S at every point; return M of both stages and the total gain."""
        dt, times = span[1] - span[0], self._times(span)
        stages = np.stack([mass, mass])
        for _ in range(MOST_ITERATIONS):
            sources = [
                self._source(t, m / J) for t, m, J in zip(times, stages, ratios, strict=True)
            ]
            gain = np.stack([J * s for J, (s, _) in zip(ratios, sources, strict=True)])
            slope = np.stack([s for _, s in sources])
            wrong = stages - mass - dt * RADAU @ gain
            (a, b), (c, d) = np.eye(2)[:, :, None] - dt * RADAU[:, :, None] * slope
            with np.errstate(all="ignore"):
                det = a * d - b * c
                change = np.stack([d * wrong[0] - b * wrong[1], a * wrong[1] - c * wrong[0]]) / det
            self._require(np.isfinite(change).all(axis=0), span[1], "has no solution")
            stages = stages - change
            if self._largest(change / np.maximum(np.abs(stages), 1.0)) < CONVERGED:
                break
        else:
            self._require(np.abs(change).max(axis=0) < CONVERGED, span[1], "has no solution")
        self._require_mass(stages, span[1])
        gained = self.sites.total(dt * RADAU[1] @ gain)
        return stages, gained

    def _conducted(
        self,
        span: tuple[float, float],
        mass: Array,
        between: Sequence[Geometry],
        nodal: Array | None,
    ) -> tuple[Array, float, Array]:
        """Integrate with flux; return M of both stages, the total gain and rho at the nodes."""
        sites, flux = self.sites, self._flux
        assert flux is not None and self.law.diffusivity is not None
        dt, times = span[1] - span[0], self._times(span)
        ratios = [sites.volume_ratio(one) for one in between]
        conduction = [self._conduction(t, at) for t, at in zip(times, between, strict=True)]
        edge = [self._edge(t) for t in times]
        density = sites.per_cell(sites.density)
        capacity = [flux.capacity(density * sites.per_cell(J)) for J in ratios]
        start = flux.load(density * sites.per_cell(mass))
        n = flux.basis.shape[-1]
        rho = np.ones((2, len(sites.cells), n)) if nodal is None else np.stack([nodal, nodal])
        factorised: Array = np.full((2, len(mass)), np.inf)
        size = np.inf
        for _ in range(MOST_ITERATIONS):
            at_points = [self._at_points(one) for one in rho]
            sources = [self._source(t, x) for t, x in zip(times, at_points, strict=True)]
            rates, slopes = [], []
            for k in range(2):
                J = density * sites.per_cell(ratios[k])
                source = flux.load(J * sites.per_cell(sources[k][0]))
                flow = np.einsum("cij,cj->ci", conduction[k], rho[k])
                rates.append(source - flow - edge[k])
                slopes.append(flux.capacity(J * sites.per_cell(sources[k][1])) - conduction[k])
            wrong, rows = [], []
            for i in range(2):
                held = np.einsum("cij,cj->ci", capacity[i], rho[i]) - start
                wrong.append(held - dt * sum(RADAU[i, j] * rates[j] for j in range(2)))
                row = [-dt * RADAU[i, j] * slopes[j] for j in range(2)]
                row[i] = row[i] + capacity[i]
                rows.append(np.concatenate(row, axis=2))
            right = np.concatenate(wrong, axis=1)
            finite = np.isfinite(right).all(axis=1)
            self._require(np.repeat(finite, sites.n_points), span[1], "has no solution")
            slope = np.stack([one for _, one in sources])
            bend = self._largest(slope - factorised)
            if dt * bend * size < CONVERGED:  # what the last Newton step has left
                break
            steady = bend <= SAME_SLOPE
            factorised = factorised if steady else slope
            change = flux.solve(None if steady else np.concatenate(rows, axis=1), right)
            rho = rho - np.stack([change[:, :n], change[:, n:]])
            size = self._largest(change)
            if size < CONVERGED:
                break
        else:
            self._require(np.zeros(len(mass), dtype=bool), span[1], "has no solution")
        stages = np.stack([ratios[k] * self._at_points(rho[k]) for k in range(2)])
        self._require_mass(stages, span[1])
        gained = dt * sum(RADAU[1, j] * float(np.sum(rates[j])) for j in range(2))
        return stages, float(sites.comm.allreduce(gained)), rho

    def _at_points(self, nodal: Array) -> Array:
        """Return values (m, n_nodes) at the points, shape (n,)."""
        assert self._flux is not None
        basis = self._flux.basis
        if basis.ndim == 2:
            return (nodal @ basis.T).ravel()
        return np.einsum("cqi,ci->cq", basis, nodal).ravel()

    def _conduction(self, t_n: float, at: Geometry) -> Array:
        """Return the cell matrices of int H J D grad u . grad w dA_ref."""
        sites, flux = self.sites, self._flux
        assert flux is not None and self.law.diffusivity is not None
        U = at.stretch
        u_11, u_22, u_12 = U.T
        determinant = u_11 * u_22 - u_12**2
        # the inverse of U, squared
        v_11, v_22, v_12 = u_22 / determinant, u_11 / determinant, -u_12 / determinant
        inverse = np.stack([v_11**2 + v_12**2, v_22**2 + v_12**2, v_12 * (v_11 + v_22)], axis=1)
        D = np.broadcast_to(self.law.diffusivity(t_n, sites.points), len(U))
        values = (D * sites.density * sites.volume_ratio(at))[:, None] * inverse
        return flux.conduction(values.reshape(len(sites.cells), sites.n_points, 3))

    def _edge(self, t_n: float) -> Array:
        flux, through = self._flux, self.law.edge_flux
        assert flux is not None
        if through is None:
            return np.zeros((len(self.sites.cells), flux.basis.shape[-1]))
        return flux.edge(lambda places: through(t_n, places))

    def _largest(self, values: Array) -> float:
        mine = float(np.max(np.abs(values), initial=0.0))
        return float(self.sites.comm.allreduce(mine, MPI.MAX))

    def _require_mass(self, stages: Array, t_n: float) -> None:
        square = 1 + self.law.stimulus.specific_volume * (stages - 1)
        enough = np.asarray((np.minimum(stages, square) > 0).all(axis=0))
        self._require(enough, t_n, "leaves no mass")

    def _require(self, good: NDArray[np.bool_], t_n: float, what: str) -> None:
        """Raise on every rank where something is not good on one (collective)."""
        place = None
        if not good.all():
            place = [float(x) for x in self.sites.points.x[int(np.argmin(good))]]
        bad = [one for one in self.sites.comm.allgather(place) if one is not None]
        if bad:
            raise UnbalancedLayer(self.name, what, bad[0], t_n)


class Mixing:
    """Anderson acceleration of x = g(x): differences of the last few turns.

    Attributes:
        t_n: Normalised time that it is for.
        given: The growth to go on with by layer, where it is not that of the last solution.
    """

    def __init__(self, t_n: float, comm: MPI.Intracomm) -> None:
        """Begin."""
        self.t_n, self._comm = t_n, comm
        self.given: dict[str, Array] = {}
        self._turns: list[tuple[Array, Array]] = []

    def __call__(self, x: Array, g: Array) -> Array:
        """Return the next x after x and g(x) (collective)."""
        self._turns = [*self._turns[-DEPTH:], (g, g - x)]
        if len(self._turns) == 1:
            return g
        residual = self._turns[-1][1]
        before = np.array([residual - r for _, r in self._turns[:-1]])
        moves = np.array([g - one for one, _ in self._turns[:-1]])
        gram = self._comm.allreduce(before @ before.T)
        right = self._comm.allreduce(before @ residual)
        weights = np.linalg.lstsq(gram, right, rcond=1e-10)[0]
        return np.asarray(g - weights @ moves)


@dataclass
class MassBalance:
    """The balances of a shell's layers along a path in t_n, and the growth that they give.

    What is known up to ``t_n`` stays: later growth is a trial until ``commit``.

    Attributes:
        layers: The balances by layer.
        geometry: Where each layer is at ``t_n``.
        tolerance: Change of e that ends the iteration with the deformation.
        kept: Number of steps of the past that are remembered.
        t_n: Time up to which growth is known.
        mass: M there by layer.
        past: The last steps, by layer each.
        trial: The step that is being tried.
    """

    layers: Mapping[str, LayerBalance]
    geometry: Mapping[str, Geometry]
    tolerance: float = 1e-5
    kept: int = 4
    t_n: float = 0.0
    mass: dict[str, Array] = field(default_factory=dict)
    past: list[dict[str, LayerStep]] = field(default_factory=list)
    trial: dict[str, LayerStep] | None = None

    def __post_init__(self) -> None:
        """Begin with the initial mass."""
        self._at_trial = self.geometry
        self._mixing: Mixing | None = None
        for name, layer in self.layers.items():
            self.mass.setdefault(name, np.ones(len(layer.sites.density)))

    @property
    def has_flux(self) -> bool:
        """Whether mass moves within some layer, so that its growth follows the deformation."""
        return any(layer.has_flux for layer in self.layers.values())

    def mass_at(self, name: str, t_n: float) -> Array:
        """Return M of a layer at its points (collective).

        Later than ``t_n`` it is that of the trial, which is solved for with the last known place
        of the layer if there is none for this time.

        Raises:
            UnbalancedLayer: There is none.
        """
        if t_n < 0:
            return self._before_start(name, t_n)
        if abs(t_n - self.t_n) <= SAME_TIME:
            return self.mass[name]
        if t_n < self.t_n:
            for steps in reversed(self.past):
                if steps[name].start <= t_n:
                    break
            return steps[name].at(t_n)
        if not self._covers(t_n):
            self._solve(t_n, self._at_trial)
        assert self.trial is not None
        mass = self.trial[name].at(t_n)
        mixing = self._mixing
        if mixing is not None and mixing.given and abs(t_n - mixing.t_n) < MIXED_NEAR:
            mass = mass + (mixing.given[name] - self.trial[name].mass[2])
        return mass

    def _covers(self, t_n: float) -> bool:
        """Whether the trial tells the growth at a time: near its end it is carried on."""
        if self.trial is None:
            return False
        one = next(iter(self.trial.values()))
        return t_n <= one.end + 0.05 * (one.end - one.start)

    def _before_start(self, name: str, t_n: float) -> Array:
        """Return M before t_n = 0, where an unstable part of a path may come: exp(S t_n)."""
        layer = self.layers[name]
        rho = np.ones(len(layer.sites.density))
        return np.asarray(np.exp(t_n * layer.law.source(0.0, layer.sites.points, rho)) * rho)

    def _solve(self, t_n: float, geometry: Mapping[str, Geometry]) -> None:
        """Try the step to ``t_n`` (collective)."""
        last = self.past[-1] if self.past else {}
        self._at_trial = geometry
        if self._mixing is not None:
            self._mixing.given = {}
        steps = {}
        for name, layer in self.layers.items():
            guess = (self.trial or last).get(name)
            nodal = None if guess is None or guess.nodal is None else guess.nodal[1]
            ends = self.geometry[name], geometry[name]
            steps[name] = layer.step((self.t_n, t_n), self.mass[name], ends, nodal)
        self.trial = steps

    def forget(self) -> None:
        """Drop the trial: it was for another step."""
        self.trial, self._at_trial = None, self.geometry
        self._mixing = None

    def settle(self, t_n: float, geometry: Mapping[str, Geometry]) -> bool:
        """Solve the balance with the shell where it is (collective).

        The growth that the shell is given next is accelerated after Anderson: what spreads fast
        follows the volume that it makes itself, and plain iteration would hardly converge.

        Args:
            t_n: Normalised time.
            geometry: Where each layer is then, at the growth of ``mass_at``.

        Returns:
            Whether that has changed the growth at ``t_n`` by more than the tolerance.
        """
        if t_n <= self.t_n + SAME_TIME:
            return False
        names = list(self.layers)
        comm = self.layers[names[0]].sites.comm
        used = np.concatenate([self.mass_at(name, t_n) for name in names])
        before = [self._factor(name, t_n) for name in names]
        mixing = self._mixing
        if mixing is None or abs(t_n - mixing.t_n) > SAME_TURN:
            mixing = Mixing(t_n, comm)
        self._solve(t_n, geometry)
        after = [self._factor(name, t_n) for name in names]
        mine = max(
            float(np.max(np.abs(a - b), initial=0.0)) for a, b in zip(after, before, strict=True)
        )
        if comm.allreduce(mine, MPI.MAX) <= self.tolerance:
            return False
        self._mixing, mixing.t_n = mixing, t_n
        found = np.concatenate([self.mass_at(name, t_n) for name in names])
        ends = np.cumsum([len(self.mass[name]) for name in names])[:-1]
        mixed = np.split(mixing(used, found), ends)
        if comm.allreduce(min(float(one.min(initial=1.0)) for one in mixed), MPI.MIN) > 0:
            mixing.given = dict(zip(names, mixed, strict=True))
        return True

    def _factor(self, name: str, t_n: float) -> Array:
        return self.layers[name].law.stimulus.factor(self.mass_at(name, t_n))

    def commit(self, t_n: float, geometry: Mapping[str, Geometry]) -> None:
        """Make the step to ``t_n`` part of the past (collective)."""
        if t_n > self.t_n + SAME_TIME:
            self._solve(t_n, geometry)
            assert self.trial is not None
            self.past = [*self.past, self.trial][-self.kept :]
            self.mass = {name: step.mass[2] for name, step in self.trial.items()}
            self.t_n = t_n
        if t_n >= self.t_n - SAME_TIME:
            self.geometry = geometry
            self.forget()

    def columns(self, t_n: float, geometry: Mapping[str, Geometry]) -> dict[str, float]:
        """Return numbers of a state for its record (collective).

        Args:
            t_n: Its normalised time.
            geometry: Where each layer is.

        Returns:
            For each layer its mass (in rho_0 R^3), the error of its balance over the step that
            led to ``t_n`` (over the mass), and mean over the layer, least and largest of e and
            rho/rho_0.
        """
        columns: dict[str, float] = {}
        for name, layer in self.layers.items():
            sites, mass = layer.sites, self.mass_at(name, t_n)
            step = self._step_to(t_n)
            columns[f"mass_{name}"] = sites.total(mass)
            columns[f"mass_error_{name}"] = 0.0 if step is None else step[name].error
            rho = mass / sites.volume_ratio(geometry[name])
            for what, values in (("e", layer.law.stimulus.factor(mass)), ("rho", rho)):
                columns[f"{what}_{name}"] = sites.total(values) / layer.initial
                columns[f"{what}_{name}_min"] = sites.extreme(values, MPI.MIN)
                columns[f"{what}_{name}_max"] = sites.extreme(values, MPI.MAX)
        return columns

    def fields(self, t_n: float, geometry: Mapping[str, Geometry]) -> dict[str, Array]:
        """Return ``e_<layer>`` and ``rho_<layer>`` at the points of the layers' cells, (m, q)."""
        fields = {}
        for name, layer in self.layers.items():
            mass = self.mass_at(name, t_n)
            rho = mass / layer.sites.volume_ratio(geometry[name])
            fields[f"e_{name}"] = layer.sites.per_cell(layer.law.stimulus.factor(mass))
            fields[f"rho_{name}"] = layer.sites.per_cell(rho)
        return fields

    def _step_to(self, t_n: float) -> dict[str, LayerStep] | None:
        """Return the step that a time lies in; None at the start and before."""
        if t_n > self.t_n + SAME_TIME:
            return self.trial
        for steps in reversed(self.past):
            if next(iter(steps.values())).start < t_n:
                return steps
        return None

    def take_over(self, laws: dict[str, Callable[..., GrowthState]]) -> None:
        """Put the balances' growth in the place of that of the laws of their layers."""
        for name in self.layers:
            law, grown = laws.get(name), BalancedGrowth(self, name)
            laws[name] = replace(law, law=grown) if isinstance(law, UnevenLayer) else grown


@dataclass(frozen=True)
class BalancedGrowth:
    """Growth of a layer by its mass balance, known at the quadrature points.

    Attributes:
        balance: The balances.
        layer: Name of the layer.
    """

    balance: MassBalance
    layer: str

    def __call__(self, t_n: float, points: SurfacePoints) -> GrowthState:
        """Return the growth at ``t_n`` at the quadrature points of some cells (collective)."""
        layer = self.balance.layers[self.layer]
        mass = self.balance.mass_at(self.layer, t_n)
        rows = np.searchsorted(layer.sites.cells, points.cells)
        mass = mass.reshape(-1, layer.sites.n_points)[rows].ravel()
        stimulus = layer.law.stimulus
        return GrowthState(stimulus.factor(mass), stimulus.density_ratio(mass))
