"""From a case to what watches the stability of its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from opticcup_fem.equilibrium.critical import Classify, CriticalPoints, Symmetrise
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.spectrum import Mode, Spectrum
from opticcup_fem.observables import Observer
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture, gather_nodes
from opticcup_fem.wavenumbers import AxisymmetricPart, AzimuthalContent, azimuthal_content


def critical_points_of(shell: Shell, newton: MixedNewton) -> CriticalPoints:
    """Return what localises and classifies the critical points of a cup (collective)."""
    spectrum = Spectrum(shell, mirrors=newton.problem.unknowns.mirrors)
    return CriticalPoints(spectrum, newton, classifier(shell), symmetriser(shell))


def symmetriser(shell: Shell) -> Symmetrise:
    """Return a function that gives the axisymmetric mean of a cup's state (collective)."""
    part: AxisymmetricPart | None = None
    index_map = shell.spaces.position.dofmap.index_map
    nodes = index_map.local_to_global(np.arange(shell.spaces.n_nodes, dtype=np.int32))

    def mean(state: ShellState) -> ShellState:
        nonlocal part
        snapshot = capture(shell, state, shell.t_n)
        positions = None
        if snapshot is not None:
            part = part or AxisymmetricPart(Observer(snapshot), snapshot)
            positions = part(snapshot)
        r = np.asarray(shell.comm.bcast(positions)[nodes])
        return shell.with_local_equilibrium(
            replace(
                state,
                r=r,
                alpha=np.zeros_like(state.alpha),
                director=shell.directors.mean_normals(r),
            )
        )

    return mean


def classifier(shell: Shell) -> Classify:
    """Return a function that gives the azimuthal content of a cup's mode on every rank."""
    observer: Observer | None = None

    def content(state: ShellState, mode: Mode) -> AzimuthalContent:
        nonlocal observer
        snapshot, motion = capture(shell, state, shell.t_n), gather_nodes(shell, mode.r)
        found: AzimuthalContent | None = None
        if snapshot is not None and motion is not None:
            observer = observer or Observer(snapshot)
            found = azimuthal_content(observer, snapshot, motion)
        shared: AzimuthalContent = shell.comm.bcast(found)
        return shared

    return content
