"""Meshes of curved surfaces.

The two tests worth reading are `test_reference_curvature_converges`, which fails when the interior
nodes do not follow the nodes of a circle's edges, and `test_cup_is_closed_and_split_on_the_circle`.
Meshes of one family are not similar to each other, so measured orders vary by one or two tenths.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import pytest
from dolfinx import fem
from scipy.spatial import cKDTree

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh import (
    Plane,
    Refinement,
    Sphere,
    SurfaceMesh,
    cup_mesh,
    disk_mesh,
    open_cap_mesh,
    read_msh,
    strip_mesh,
    write_msh,
)
from opticcup_fem.mesh.distribute import distribute
from opticcup_fem.mesh.gmsh_session import gmsh_model
from opticcup_fem.mesh.msh_file import gather
from opticcup_fem.mesh.triangulation import Triangulation, corner_angles

ALPHA = math.radians(40.0)
SIZES = np.array([0.22, 0.12, 0.35])
COMM = MPI.COMM_SELF
ROUNDING = 4e-15  # a few operations on numbers of order one


def cup(factor: float = 1.0, alpha: float = ALPHA, seed: int = 1) -> SurfaceMesh:
    return cup_mesh(alpha, *(factor * SIZES), seed=seed, comm=COMM)


def lagrange(
    mesh: SurfaceMesh,
    degree: int,
    variant: basix.LagrangeVariant = basix.LagrangeVariant.equispaced,
) -> fem.FunctionSpace:
    element = basix.ufl.element(
        "Lagrange", "triangle", degree, lagrange_variant=variant, shape=(3,)
    )
    return fem.functionspace(mesh.mesh, element)


def serial(mesh: SurfaceMesh) -> Triangulation:
    triangulation = gather(mesh)
    assert triangulation is not None
    return triangulation


def geometry(mesh: SurfaceMesh, degree: int) -> dict[str, npt.NDArray[np.float64]]:
    """Metric and curvature of the reference position, at 25 points of every cell."""
    space = lagrange(mesh, degree)
    nodes = mesh.reference_position(space).x.array.reshape(-1, 3)[space.dofmap.list]
    element = basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.triangle,
        degree,
        basix.LagrangeVariant.equispaced,
    )
    points, weights = basix.make_quadrature(basix.CellType.triangle, 8)
    # rows of the table: value, d/dX, d/dY, d2/dX2, d2/dXdY, d2/dY2
    _, x, y, xx, xy, yy = np.einsum("dqn,cni->dcqi", element.tabulate(2, points)[..., 0], nodes)
    cross = np.cross(x, y)
    area = np.linalg.norm(cross, axis=-1)
    normal = cross / area[..., None] * mesh.orientation()[:, None, None]
    first, second = np.stack([x, y], -2), np.stack([xx, xy, xy, yy], -2)
    a = first @ np.swapaxes(first, -1, -2)
    b = np.einsum("cqi,cqki->cqk", normal, second).reshape(*area.shape, 2, 2)
    return {"dA": area * weights, "shape": np.linalg.solve(a, b)}


def order(errors: list[float], factor: float = 2.0) -> float:
    """Slope of a least-squares line through the logarithms, sizes shrinking by ``factor``."""
    steps = -np.arange(len(errors)) * math.log(factor)
    return float(np.polyfit(steps, np.log(errors), 1)[0])


# --- the meshes


@pytest.mark.parametrize("degrees", [20.0, 40.0, 90.0, 140.0])
def test_cup_is_closed_and_split_on_the_circle(degrees: float) -> None:
    alpha = math.radians(degrees)
    mesh = cup_mesh(alpha, 0.2, 0.1, 0.3, comm=COMM)
    whole = serial(mesh)
    edges = np.sort(whole.cells[:, [[1, 2], [0, 2], [0, 1]]], axis=-1).reshape(-1, 2)
    unique, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    assert np.all(count == 2)
    assert len(whole.points) - len(unique) + len(whole.cells) == 2  # Euler: a sphere
    # colatitude of every cell's centre agrees with its region
    centre = whole.points[whole.cells].mean(axis=1)
    theta = np.arccos(centre[:, 2] / np.linalg.norm(centre, axis=1))
    assert np.all((theta < alpha) == (whole.cell_region == mesh.regions["cap"]))
    # the tagged edges are exactly those between the two regions
    region = np.repeat(whole.cell_region, 3)
    between = np.bincount(inverse, weights=region) == sum(mesh.regions.values())
    assert {tuple(e) for e in unique[between]} == {tuple(e) for e in np.sort(whole.edges, axis=1)}


@pytest.mark.parametrize("radius", [1.0, 50.0])
def test_cup_vertices_are_exact(radius: float) -> None:
    mesh = cup_mesh(ALPHA, *(radius * SIZES), comm=COMM, radius=radius)
    whole = serial(mesh)
    np.testing.assert_allclose(np.linalg.norm(whole.points, axis=1), radius, rtol=ROUNDING)
    rim = whole.points[np.unique(whole.edges)]
    np.testing.assert_allclose(rim[:, 2], radius * math.cos(ALPHA), rtol=ROUNDING)
    rows = {tuple(point) for point in whole.points}
    assert {(0.0, 0.0, radius), (0.0, 0.0, -radius)} <= rows
    start = rim[np.argmin(np.abs(rim[:, 1]) - rim[:, 0])]
    np.testing.assert_allclose(start[:2], [radius * math.sin(ALPHA), 0.0], rtol=ROUNDING)


@pytest.mark.parametrize("seed", range(4))
def test_cup_triangles_are_well_shaped_and_graded(seed: int) -> None:
    mesh = cup(seed=seed)
    whole = serial(mesh)
    angles = np.degrees(corner_angles(whole.points, whole.cells))
    assert angles.min() > 28.0
    assert angles.max() < 115.0
    assert np.median(angles.min(axis=1)) > 48.0  # most are nearly equilateral
    assert 480 < len(whole.cells) < 560
    corners = whole.points[whole.cells]
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    theta = np.arccos(np.clip(corners.mean(axis=1)[:, 2], -1, 1))
    for near, wanted in ((abs(theta - ALPHA) < 0.06, 0.12), (theta > 2.0, 0.35)):
        assert size[near].mean() == pytest.approx(wanted, rel=0.2)


def test_halving_the_sizes_halves_every_cell() -> None:
    counts = [cup(factor).mesh.topology.index_map(2).size_global for factor in (1.0, 0.5, 0.25)]
    for coarse, fine in pairwise(counts):
        assert fine / coarse == pytest.approx(4.0, rel=0.15)


def test_seed_decides_the_mesh() -> None:
    one, again, other = (serial(cup(seed=seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.points, again.points)
    np.testing.assert_array_equal(one.cells, again.cells)
    assert one.points.shape != other.points.shape or np.abs(one.points - other.points).max() > 0.01


@pytest.mark.parametrize("planes", [1, 4, 6])
def test_symmetric_mesh_is_its_own_mirror_image(planes: int) -> None:
    """It has that many mirror planes and no more, and is as good as one without."""
    mesh = cup_mesh(ALPHA, *SIZES, comm=COMM, symmetry=planes)
    triangulation = serial(mesh)
    points, cells = triangulation.points, triangulation.cells
    regions = triangulation.cell_region
    tree = cKDTree(points)
    known = {(*sorted(cell), region) for cell, region in zip(cells.tolist(), regions, strict=True)}
    for k in range(planes + 1):
        angle = math.pi * k / planes if k < planes else math.pi / 2 / planes
        cosine, sine = math.cos(2 * angle), math.sin(2 * angle)
        mirror = np.array([[cosine, sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
        apart, number = tree.query(points @ mirror)
        if k == planes:  # half-way between two planes there is none
            assert apart.max() > 0.01
            continue
        assert apart.max() < ROUNDING
        images = number[cells].tolist()
        assert {(*sorted(c), r) for c, r in zip(images, regions, strict=True)} == known
    angles = np.degrees(corner_angles(points, cells))
    assert angles.min() > 25 and angles.max() < 120
    edges = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)  # closed


@pytest.mark.parametrize(
    ("azimuth", "planes", "images"),
    [(0.4, 0, [0.4]), (0.0, 2, [0.0, math.pi]), (0.4 + math.pi, 2, [0.4, -0.4, math.pi - 0.4])],
)
@pytest.mark.parametrize("radius", [1.0, 50.0])
def test_cells_are_small_in_refinements_and_in_their_images(
    azimuth: float, planes: int, images: list[float], radius: float
) -> None:
    spot = Refinement(1.3, azimuth, 0.2 * radius, 0.04 * radius)
    sizes = radius * SIZES
    settings: dict[str, Any] = {"radius": radius, "symmetry": planes, "comm": COMM}
    whole = serial(cup_mesh(ALPHA, *sizes, **settings, refinements=[spot]))
    bare = serial(cup_mesh(ALPHA, *sizes, **settings))
    corners = whole.points[whole.cells] / radius
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    centre = corners.mean(axis=1)
    distance = np.full(len(size), np.inf)
    for image in images:
        place = [math.sin(1.3) * math.cos(image), math.sin(1.3) * math.sin(image), math.cos(1.3)]
        away = np.arccos(np.clip(centre @ place / np.linalg.norm(centre, axis=1), -1, 1))
        assert size[away < 0.18].mean() == pytest.approx(0.04, rel=0.15)
        distance = np.minimum(distance, away)
    if len(images) == 2 or planes == 0:  # all of them
        assert size[(distance > 0.9) & (centre[:, 2] < 0)].mean() == pytest.approx(0.35, rel=0.2)
        added = len(whole.cells) - len(bare.cells)
        disc = math.pi * 0.2**2 / (math.sqrt(3) / 4 * 0.04**2)
        assert len(images) * disc < added < 3 * len(images) * disc
    angles = np.degrees(corner_angles(whole.points, whole.cells))
    assert angles.min() > 25 and angles.max() < 120


def test_symmetric_meshes_differ_by_their_seed() -> None:
    one, other = (cup_mesh(ALPHA, *SIZES, seed, COMM, symmetry=4) for seed in (1, 2))
    assert not np.array_equal(serial(one).points, serial(other).points)


def test_open_cap_and_disk_have_a_rim_and_a_centre() -> None:
    cap = open_cap_mesh(ALPHA, 0.15, comm=COMM, radius=2.0)
    disk = disk_mesh(3.0, 0.5, cell_size_rim=0.3, comm=COMM)
    for mesh, centre, radius, height in (
        (cap, 2.0, 2.0 * math.sin(ALPHA), 2.0 * math.cos(ALPHA)),
        (disk, 0.0, 3.0, 0.0),
    ):
        whole = serial(mesh)
        assert (0.0, 0.0, centre) in {tuple(point) for point in whole.points}
        rim = whole.points[np.unique(whole.edges)]
        np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), radius, rtol=ROUNDING)
        np.testing.assert_allclose(rim[:, 2], height, rtol=ROUNDING)
        # a disc: Euler's number 1 with the rim as its only boundary
        edges = np.sort(whole.cells[:, [[1, 2], [0, 2], [0, 1]]], axis=-1).reshape(-1, 2)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        assert len(whole.points) - len(unique) + len(whole.cells) == 1
        assert {tuple(e) for e in unique[count == 1]} == {
            tuple(e) for e in np.sort(whole.edges, axis=1)
        }
    assert len(serial(disk).edges) == round(2 * math.pi * 3.0 / 0.3)


def test_strip_has_named_sides_and_alternating_diagonals() -> None:
    mesh = strip_mesh(2.0, 0.5, 6, 3, comm=COMM)
    whole = serial(mesh)
    assert len(whole.cells) == 2 * 6 * 3
    for name, axis, value, count in (
        ("left", 0, 0.0, 3),
        ("right", 0, 2.0, 3),
        ("bottom", 1, 0.0, 6),
        ("top", 1, 0.5, 6),
    ):
        side = whole.points[whole.edges[whole.edge_curve == mesh.curves[name]]]
        assert len(side) == count
        np.testing.assert_array_equal(side[..., axis], value)
    corners = whole.points[whole.cells]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    np.testing.assert_allclose(areas, 2.0 * 0.5 / 36, rtol=1e-13)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).argmax(axis=1)
    rows = np.arange(len(corners))
    diagonal = corners[rows, longest] - corners[rows, longest - 1]
    rising = diagonal[:, 0] * diagonal[:, 1] > 0
    assert np.count_nonzero(rising) == np.count_nonzero(~rising)


@pytest.mark.parametrize("flat", [False, True])
def test_orientation_follows_the_surface_not_the_vertex_order(flat: bool) -> None:
    original = strip_mesh(1.0, 1.0, 4, 4, comm=COMM) if flat else cup(2.0)
    whole = serial(original)
    turned = whole.cells.copy()
    turned[::3] = turned[::3, ::-1]
    mixed = distribute(lambda: replace(whole, cells=turned), original.surface, COMM)
    expected = np.ones(len(turned))
    expected[::3] = -1.0
    cell = mixed.mesh.topology.original_cell_index
    np.testing.assert_array_equal(original.orientation(), 1.0)
    np.testing.assert_array_equal(mixed.orientation(), expected[cell])


# --- reference positions


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
@pytest.mark.parametrize(
    "variant", [basix.LagrangeVariant.equispaced, basix.LagrangeVariant.gll_warped]
)
def test_reference_nodes_lie_on_sphere_and_circle(
    degree: int, variant: basix.LagrangeVariant
) -> None:
    mesh = cup()
    space = lagrange(mesh, degree, variant)
    position = mesh.reference_position(space).x.array.reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 1.0, rtol=ROUNDING)
    edges = mesh.facet_tags.find(mesh.curves["interface"])
    dofs = fem.locate_dofs_topological(space, 1, edges)
    assert len(dofs) == degree * len(edges)
    circle = position[dofs]
    np.testing.assert_allclose(circle[:, 2], math.cos(ALPHA), rtol=ROUNDING)
    if variant == basix.LagrangeVariant.equispaced:
        phi = np.sort(np.arctan2(circle[:, 1], circle[:, 0]))
        np.testing.assert_allclose(np.diff(phi), 2 * math.pi / len(dofs), rtol=1e-12)


def test_a_flat_strip_is_left_as_it_is() -> None:
    mesh = strip_mesh(2.0, 0.5, 6, 3, comm=COMM)
    space = lagrange(mesh, 3)
    position = mesh.reference_position(space).x.array.reshape(-1, 3)
    np.testing.assert_allclose(position, space.tabulate_dof_coordinates(), atol=1e-15)


@pytest.mark.parametrize(
    ("build", "area"),
    [
        (cup, 4 * math.pi),
        (lambda f: open_cap_mesh(ALPHA, 0.25 * f, comm=COMM), 2 * math.pi * (1 - math.cos(ALPHA))),
        (lambda f: disk_mesh(1.0, 0.35 * f, comm=COMM), math.pi),
    ],
    ids=["cup", "open cap", "disk"],
)
def test_cubic_area_converges(build: Callable[[float], SurfaceMesh], area: float) -> None:
    errors = [abs(geometry(build(f), 3)["dA"].sum() - area) for f in (1.0, 0.5, 0.25)]
    print("area errors", errors, "order", order(errors))
    assert order(errors) > 3.8


def test_cap_of_the_cup_has_its_exact_area_in_the_limit() -> None:
    errors = []
    for factor in (1.0, 0.5, 0.25):
        mesh = cup(factor)
        in_cap = mesh.cell_tags.values == mesh.regions["cap"]
        area = geometry(mesh, 3)["dA"][in_cap].sum()
        errors.append(abs(area - 2 * math.pi * (1 - math.cos(ALPHA))))
    print("cap area errors", errors, "order", order(errors))
    assert errors[0] < 2e-6  # 4.7e-6 where edge nodes are only projected radially
    assert order(errors) > 3.7


def test_reference_curvature_converges() -> None:
    """The shape operator tends to -1/R at order 2, in mean square and next to the circle."""
    errors, at_circle, totals = [], [], []
    for factor in (1.0, 0.5, 0.25):
        mesh = cup(factor)
        parts = geometry(mesh, 3)
        difference = parts["shape"] - mesh.surface.curvature * np.eye(2)
        square = (difference**2).sum(axis=(-2, -1))
        errors.append(math.sqrt((square * parts["dA"]).sum()))
        on_circle = np.isclose(mesh.corners()[..., 2], math.cos(ALPHA), rtol=0, atol=1e-12)
        at_circle.append(math.sqrt(square[on_circle.sum(axis=1) == 2].mean()))
        gauss = np.linalg.det(parts["shape"])
        totals.append(abs(float((gauss * parts["dA"]).sum()) - 4 * math.pi))
    for name, values in (("mean", errors), ("at circle", at_circle), ("total Gauss", totals)):
        print(f"curvature error, {name}: {values}, order {order(values):.2f}")
    assert errors[0] < 0.04  # 0.18 where edge nodes are only projected radially
    assert order(errors) > 1.8
    assert order(at_circle) > 1.8
    assert order(totals) > 1.8  # without the angles between cells, which are of the same order


def test_reference_position_refuses_other_spaces() -> None:
    mesh = cup(2.0)
    for space in (
        fem.functionspace(mesh.mesh, ("Lagrange", 2)),
        fem.functionspace(mesh.mesh, ("RT", 1)),
    ):
        with pytest.raises(MeshError, match="vector Lagrange space"):
            mesh.reference_position(space)


# --- surfaces


def test_sphere_and_plane() -> None:
    x = np.random.default_rng(3).normal(size=(20, 3))
    sphere, plane = Sphere(2.5), Plane()
    np.testing.assert_allclose(np.linalg.norm(sphere.project(x), axis=1), 2.5, rtol=ROUNDING)
    np.testing.assert_allclose(sphere.project(x), 2.5 * sphere.normal(x), rtol=ROUNDING)
    assert np.all(np.einsum("ni,ni->n", sphere.normal(x), x) > 0)  # outward
    assert sphere.curvature == -0.4  # b = n . r_,ab = -a/R with n outward
    np.testing.assert_array_equal(plane.project(x)[:, :2], x[:, :2])
    np.testing.assert_array_equal(plane.project(x)[:, 2], 0.0)
    np.testing.assert_array_equal(plane.normal(x), np.tile([0.0, 0.0, 1.0], (20, 1)))
    assert plane.curvature == 0.0


# --- files


def test_file_returns_the_same_mesh(tmp_path: Path) -> None:
    mesh = cup()
    write_msh(mesh, tmp_path / "cup.msh")
    copy = read_msh(tmp_path / "cup.msh", Sphere(1.0), comm=COMM)
    one, two = serial(mesh), serial(copy)
    np.testing.assert_allclose(two.points, one.points, atol=1e-15)
    np.testing.assert_array_equal(two.cells, one.cells)
    np.testing.assert_array_equal(two.cell_region, one.cell_region)
    np.testing.assert_array_equal(two.edges, one.edges)
    assert (copy.regions, copy.curves) == (mesh.regions, mesh.curves)
    assert copy.circles == {"interface"}


def test_standard_meshes_are_readable() -> None:
    folder = Path(__file__).parents[2] / "meshes"
    files = sorted(folder.glob("*.msh"))
    assert files
    for file in files:
        surface = Sphere(1.0) if "cup" in file.stem or "cap" in file.stem else Plane()
        mesh = read_msh(file, surface, comm=COMM)
        assert mesh.mesh.topology.index_map(2).size_global > 90
        assert np.all(mesh.orientation() == 1.0)


def test_unusable_files_are_refused(tmp_path: Path) -> None:
    mesh = cup(2.0)
    good = tmp_path / "cup.msh"
    write_msh(mesh, good)
    with pytest.raises(MeshError, match=r"there is no mesh file .*none\.msh"):
        read_msh(tmp_path / "none.msh", Sphere(1.0), comm=COMM)
    with pytest.raises(MeshError, match="vertices 1 off Sphere"):
        read_msh(good, Sphere(2.0), comm=COMM)
    with pytest.raises(MeshError, match=r"'interface' of the mesh .* is not a circle"):
        whole = serial(mesh)
        tilted = whole.points[:, [2, 1, 0]]
        turned = distribute(lambda: replace(whole, points=tilted), Sphere(1.0), COMM)
        write_msh(turned, tmp_path / "tilted.msh")
        read_msh(tmp_path / "tilted.msh", Sphere(1.0), comm=COMM)
    (tmp_path / "text.msh").write_text("not a mesh\n")
    with pytest.raises(MeshError, match=r"text\.msh|Gmsh failed"):
        read_msh(tmp_path / "text.msh", Sphere(1.0), comm=COMM)
    with pytest.raises(MeshError, match="cannot write the mesh"):
        write_msh(mesh, tmp_path / "missing" / "cup.msh")


# --- manners


def test_report_counts_cells_and_edges() -> None:
    mesh = strip_mesh(1.0, 1.0, 3, 2, comm=COMM)
    assert mesh.report() == (
        "12 cells (strip 12); edges: left 2, right 2, bottom 3, top 3; angles 34 to 90 degrees"
    )


@pytest.fixture
def session() -> Iterator[None]:
    import gmsh

    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield
    gmsh.finalize()


@pytest.mark.usefixtures("session")
def test_a_users_gmsh_session_is_left_alone() -> None:
    import gmsh

    gmsh.model.add("mine")
    point = gmsh.model.geo.addPoint(0, 0, 0)
    gmsh.option.setNumber("Mesh.Algorithm", 5)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
    models = gmsh.model.list()
    cup(2.0)
    assert gmsh.isInitialized()
    assert gmsh.model.list() == models
    assert gmsh.model.getCurrent() == "mine"
    assert gmsh.option.getNumber("Mesh.Algorithm") == 5
    assert gmsh.option.getNumber("Mesh.MeshSizeMax") == 0.7
    gmsh.model.geo.synchronize()
    assert gmsh.model.getEntities(0) == [(0, point)]


def test_gmsh_is_finalised_and_silent(capfd: pytest.CaptureFixture[str]) -> None:
    import gmsh

    cup(2.0)
    with pytest.raises(MeshError, match="Gmsh failed"), gmsh_model() as inner:
        inner.model.setCurrent("no such model")
        inner.model.mesh.getElement(12345)
    assert not gmsh.isInitialized()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: cup_mesh(4.0, *SIZES), "opening angle is 4 rad"),
        (lambda: cup_mesh(0.0, *SIZES), "between 0 and pi"),
        (lambda: cup_mesh(math.nan, *SIZES), "opening angle is nan"),
        (lambda: cup_mesh(ALPHA, -0.2, 0.1, 0.3), "cell_size_cap is -0.2"),
        (lambda: cup_mesh(ALPHA, 0.2, 0.0, 0.3), "cell_size_interface is 0"),
        (lambda: cup_mesh(ALPHA, 0.2, 0.1, math.inf), "cell_size_oov is inf"),
        (lambda: cup_mesh(ALPHA, 0.2, 0.1, 0.3, transition=0.0), "transition is 0"),
        (lambda: cup_mesh(ALPHA, *SIZES, radius=-1.0), "radius of the sphere is -1"),
        (lambda: cup_mesh(ALPHA, *SIZES, symmetry=9), "symmetry is 9"),
        (lambda: Refinement(4.0, 0.0, 0.1, 0.1), "colatitude 4 rad .*180 degrees"),
        (lambda: Refinement(1.0, math.inf, 0.1, 0.1), "azimuth inf"),
        (lambda: Refinement(1.0, 0.0, -0.1, 0.1), "extent -0.1"),
        (lambda: Refinement(1.0, 0.0, 0.1, 0.0), "cell size 0; give .* above 0"),
        (lambda: cup_mesh(ALPHA, 0.8, 0.8, 0.8), r"gives 5 edges .* to 0.505 or less"),
        (lambda: open_cap_mesh(ALPHA, 0.7), "too coarse: cell_size_rim = 0.7"),
        (lambda: open_cap_mesh(-1.0, 0.1), "opening angle is -1 rad"),
        (lambda: disk_mesh(0.0, 0.1), "radius is 0"),
        (lambda: disk_mesh(1.0, 0.1, cell_size_rim=2.0), "too coarse: cell_size_rim = 2"),
        (lambda: strip_mesh(1.0, -1.0, 4, 1), "width is -1"),
        (lambda: strip_mesh(1.0, 1.0, 4, 0), "cells_across is 0"),
    ],
)
def test_impossible_requests_are_refused(build: Callable[[], SurfaceMesh], sentence: str) -> None:
    with pytest.raises(MeshError, match=sentence):
        build()
