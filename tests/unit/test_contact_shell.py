"""Contact of a whole shell: with itself and with obstacles, in equilibrium.

What matters: the problem's gradient and tangent are those of its energy, across parts that are not
neighbours; nothing changes where nothing touches; a pressed sphere is held by its plates, balances
their forces, and comes back; obstacles that overlap are refused.
"""

from dataclasses import replace

import numpy as np
import pytest

from opticcup_fem.contact.model import KEEP, Contact
from opticcup_fem.contact.obstacles import Plate, Sphere
from opticcup_fem.contact.potential import ContactSettings
from opticcup_fem.contact.report import ContactReport, contact_report, nodal_areas
from opticcup_fem.equilibrium import path
from opticcup_fem.equilibrium.jumps import make_relaxation
from opticcup_fem.equilibrium.newton import CONTACT_AHEAD, MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint, StepControl
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.tangent import on_tangent
from opticcup_fem.errors import CaseError
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture
from opticcup_fem.shell.supports import Mask, free, held_components, rigid_modes_of_cup
from tests.support.shells import ALPHA, disturbed, sphere_shell, wall

H = 0.1
SETTINGS = ContactSettings(distance=0.02, stiffness=1.0)
DEPTH = 0.06
"""How far each plate has moved into the sphere at t_n = 1."""


def plates(gap: float, depth: float = DEPTH) -> list[Plate]:
    """Two plates that stand ``gap`` off the sphere's outer face and move in evenly."""
    height = 1 + H / 2 + gap
    return [
        Plate((0, 0, side * height), (0, 0, 1), 3.0, velocity=(0, 0, -side * (depth + gap)))
        for side in (1, -1)
    ]


def upright(shell: Shell) -> Mask:
    """Hold both poles on the axis, and the turn about it: plates push along it."""
    side = (np.sin(ALPHA), 0.0, np.cos(ALPHA))
    return held_components(shell, [((0, 0, -1), "xy"), ((0, 0, 1), "xy"), (side, "y")])


@pytest.fixture(scope="module")
def shell() -> Shell:
    return sphere_shell(wall(H))


@pytest.fixture(scope="module")
def squeezed(shell: Shell) -> tuple[LoadStepping, list[PathPoint]]:
    """A sphere squeezed between two plates, and the states on the way."""
    shell.set_time(0.0)
    problem = Problem(shell, upright(shell), Contact(shell, SETTINGS, plates(0.021)))
    newton = MixedNewton(problem)
    control = StepControl(initial=0.1, largest=0.25, smallest=1e-3)
    stepping = LoadStepping(problem, newton, make_relaxation(problem, newton), control)
    points = list(stepping.follow(shell.reference_state(), 1.0))
    assert stepping.failure() is None
    return stepping, points


def test_gradient_and_tangent_are_derivatives_of_the_energy(shell: Shell) -> None:
    """Of shell and contact together, in a state that touches: remainders of order 2 and 3."""
    contact = Contact(shell, SETTINGS, plates(0.021, depth=0.0))
    problem = Problem(shell, free(shell), contact)
    shell.set_time(0.009 / 0.021)  # the plates have come nearer by 0.009
    state = problem.with_contact(disturbed(shell, 1e-4))
    assert contact.gap(state) == pytest.approx(0.012, abs=1e-3)
    cells = shell.condensed(state)
    gradient = problem.vector.duplicate()
    problem.assemble_gradient(cells, state, gradient)
    far = problem.contact_stiffness(state)
    assert far is not None
    problem.assemble_tangent(cells, far)
    local = np.zeros(len(problem.unknowns.held))
    local[: state.r.size] = np.random.default_rng(4).normal(size=state.r.size)
    local[problem.unknowns.held] = 0.0
    dr, dalpha = problem.unknowns.split(local)
    direction = problem.vector.duplicate()
    direction.array[:] = problem.unknowns.owned_values(dr, dalpha)
    image = direction.duplicate()
    problem.matrix.mult(direction, image)
    slope, bend = gradient.dot(direction), direction.dot(image)
    steps, rests = 2e-4 * 0.5 ** np.arange(4), []
    start = problem.energy(state)
    for step in steps:
        moved = replace(state, r=state.r + step * dr)
        change = problem.energy(shell.with_local_equilibrium(moved)) - start
        rests.append((abs(change - step * slope), abs(change - step * slope - step**2 * bend / 2)))
    first, second = np.polyfit(np.log(steps), np.log(rests), 1)[0]
    assert first == pytest.approx(2, abs=0.15)
    assert second == pytest.approx(3, abs=0.4)


def test_plates_hold_the_sphere(squeezed: tuple[LoadStepping, list[PathPoint]]) -> None:
    """Faces stay outside the plates; their forces balance and grow as they close in."""
    stepping, points = squeezed
    problem, contact = stepping.problem, stepping.problem.contact
    assert contact is not None
    forces = []
    for point in points:
        problem.shell.set_time(point.t_n)
        assert point.negative_eigenvalues == 0
        snapshot = capture(problem.shell, point.state, point.t_n)
        report = contact_report(contact, point.state)
        assert snapshot is not None and report is not None
        height = 1 + H / 2 + 0.021 - point.t_n * (DEPTH + 0.021)
        for faces in snapshot.faces.values():
            assert np.abs(faces[..., 2]).max() < height
        above = report.forces[:, 2] < 0
        assert (snapshot.position[above, 2] > 0.8).all()
        total = report.forces.sum(axis=0)
        assert abs(total[2]) < 1e-3 * np.abs(report.forces).sum() + 1e-9
        forces.append(-report.forces[above, 2].sum())
        if forces[-1] > 0:
            columns = report.columns(snapshot)
            # one patch under each plate, small against the sphere
            assert 0 <= columns["touching_length_over_R"] < 0.9
            assert 0 < columns["touching_area_over_R2"] < 1.0
            assert columns["contact_force"] >= 2 * forces[-1] * (1 - 1e-3)
    assert forces[0] == 0
    assert (np.diff(forces) >= 0).all() and forces[-1] > 0


def test_squeezed_sphere_comes_back(squeezed: tuple[LoadStepping, list[PathPoint]]) -> None:
    """Followed down in t_n the plates open and the sphere is as it was."""
    stepping, points = squeezed
    *_, last = stepping.follow(points[-1].state, 0.0, t_start=1.0)
    assert last.t_n == 0.0 and last.state.contact is not None
    assert not last.state.contact.touches
    np.testing.assert_allclose(last.state.r, points[0].state.r, atol=1e-6)


def test_solve_that_contact_stops_early_is_not_begun(
    squeezed: tuple[LoadStepping, list[PathPoint]],
) -> None:
    """From the last state to a guess in which the plates are far inside, and to one just ahead."""
    stepping, points = squeezed
    newton, last = stepping.newton, points[-1].state
    solved = []
    for t_n in (1.001, 1.5):
        stepping.problem.shell.set_time(t_n)
        solved.append(newton.solve(last, before=last, least_way=0.75))
    assert solved[0].converged and solved[0].iterations > 0
    assert solved[1].reason == CONTACT_AHEAD
    assert not solved[1].converged and solved[1].iterations == 0
    assert newton.solve(last, before=last).iterations > 0


def test_a_step_keeps_half_of_a_gap(squeezed: tuple[LoadStepping, list[PathPoint]]) -> None:
    """Of all nodes outwards, into the plates; inwards it may go all the way."""
    stepping, points = squeezed
    problem, state = stepping.problem, points[-1].state
    contact = problem.contact
    assert contact is not None
    before, outwards = contact.gap(state), 0.05 * problem.shell.reference
    share = problem.free_fraction(state, outwards)
    assert 0 < share < 0.9
    after = contact.gap(replace(state, r=state.r + share * outwards))
    assert KEEP * before <= after * (1 + 1e-9) and after < 0.8 * before
    assert problem.free_fraction(state, -outwards) == 1.0


def test_more_contact_on_the_way(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball that flies into a squeezed sphere stops the way to a guess that is not told of it."""
    ball = Sphere((2.0, 0.0, 0.0), 0.3, velocity=(-0.68, 0.0, 0.0))
    shell.set_time(0.0)
    problem = Problem(shell, upright(shell), Contact(shell, SETTINGS, [*plates(0.021), ball]))
    newton = MixedNewton(problem)
    control = StepControl(initial=0.1, largest=0.25, smallest=1e-3)
    stepping = LoadStepping(problem, newton, make_relaxation(problem, newton), control)
    begun: list[float] = []

    def counted(problem: Problem, state: ShellState, t_n: float, dt: float) -> ShellState | None:
        begun.append(t_n)
        return on_tangent(problem, state, t_n, dt)

    monkeypatch.setattr(path, "on_tangent", counted)
    *_, last = stepping.follow(shell.reference_state(), 1.0)
    assert stepping.failure() is None and last.t_n == 1.0 and last.stable
    # at the first touch of a plate, and where the ball is in the way
    assert len(set(begun)) >= 2 and begun[0] < 0.5 < begun[-1]
    side = last.state.r[np.argmax(shell.reference[:, 0])]
    assert side[0] + H / 2 <= 2.0 - 0.68 - 0.3 + 1e-3


def test_tangent_follows_the_plates(squeezed: tuple[LoadStepping, list[PathPoint]]) -> None:
    """The tangent of a path in touch knows how stiff contact is, and how obstacles move."""
    stepping, points = squeezed
    problem, t_n = stepping.problem, points[-1].t_n
    assert problem.contact is not None

    def solved(state: ShellState) -> ShellState:
        while True:
            solution = stepping.newton.solve(state, before=state)
            assert solution.converged
            state, is_as_good = problem.contact.renewed(solution.state, lag=1e-6)
            if is_as_good:
                return state

    problem.shell.set_time(t_n)
    start = solved(points[-1].state)
    for dt in (1e-4, -1e-4):
        ahead = on_tangent(problem, start, t_n, dt)
        assert ahead is not None
        there = solved(start)
        error = np.linalg.norm(ahead.r - there.r)
        assert error < 0.03 * np.linalg.norm(there.r - start.r)


def test_nothing_changes_where_nothing_touches() -> None:
    """The same states, bit by bit, with contact that is never made."""
    grown = sphere_shell(wall(H), rate=0.5)
    ends = []
    for contact in (None, Contact(grown, SETTINGS)):
        problem = Problem(grown, rigid_modes_of_cup(grown), contact)
        newton = MixedNewton(problem)
        stepping = LoadStepping(
            problem, newton, make_relaxation(problem, newton), StepControl(initial=0.2, largest=0.5)
        )
        ends.append([*stepping.follow(grown.reference_state(), 1.0)])
    assert len(ends[0]) == len(ends[1])
    for one, other in zip(*ends, strict=True):
        assert np.array_equal(one.state.r, other.state.r)
        assert one.energy == other.energy and one.iterations == other.iterations


def test_overlapping_obstacle_is_refused(shell: Shell) -> None:
    """One sentence that says what to do."""
    shell.set_time(0.0)
    with pytest.raises(CaseError, match="overlaps the shell at the start: move it"):
        Contact(shell, SETTINGS, plates(-0.02))
    with pytest.raises(CaseError, match="overlaps the shell at the start: move it"):
        Contact(shell, SETTINGS, [Sphere((0.0, 0.0, 1.0), 0.2 * H, refinements=0)])


def test_obstacle_within_the_barrier_is_refused(shell: Shell) -> None:
    """Newton's method would start from forces that nothing has led up to."""
    shell.set_time(0.0)
    with pytest.raises(CaseError, match=r"nearer to the shell .* than the barrier reaches, 0\.02"):
        Contact(shell, SETTINGS, plates(0.015))


def test_nodal_areas_are_those_of_the_surface(shell: Shell) -> None:
    """They are positive and their sum is 4 pi, but for the flatness of triangles."""
    snapshot = capture(shell, shell.reference_state(), 0.0)
    assert snapshot is not None
    areas = nodal_areas(snapshot, snapshot.reference)
    assert areas.shape == (len(snapshot.reference),) and (areas > 0).all()
    assert areas.sum() == pytest.approx(4 * np.pi, rel=0.01)
    twice = nodal_areas(snapshot, 2 * snapshot.reference)
    assert twice.sum() == pytest.approx(4 * areas.sum())


def test_touching_area_and_length_are_those_of_the_patches(shell: Shell) -> None:
    """Two caps of 0.3 rad, pushed: their area together, and the diameter of one."""
    snapshot = capture(shell, shell.reference_state(), 0.0)
    assert snapshot is not None
    areas = nodal_areas(snapshot, snapshot.reference)
    theta = np.arccos(np.abs(snapshot.reference[:, 2]))
    forces = np.where(theta < 0.3, areas, 1e-3 * areas)[:, None] * [0.0, 0.0, 1.0]
    columns = ContactReport(1.5, forces).columns(snapshot)
    assert columns["contact_energy"] == 1.5
    assert columns["contact_force"] == pytest.approx(np.abs(forces).sum())
    cap = 2 * np.pi * (1 - np.cos(0.3))
    assert columns["touching_area_over_R2"] == pytest.approx(2 * cap, rel=0.25)
    assert columns["touching_length_over_R"] == pytest.approx(2 * np.sin(0.3), rel=0.15)
    none = ContactReport(0.0, 0 * forces).columns(snapshot)
    assert none["touching_area_over_R2"] == none["touching_length_over_R"] == 0.0
