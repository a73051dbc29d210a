"""The 3D part of a movie's frames: one body, seen by a camera that stays where it is."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.colors import Normalize, to_rgb
from numpy.typing import NDArray

from opticcup_fem.plots import style
from opticcup_fem.plots.body import BodyGrid, Shape, Surface, layer_surfaces
from opticcup_fem.plots.scene_colours import colour_map
from opticcup_fem.snapshot import Floats

_FADED = 0.62
"""How far shapes that are no equilibria are washed out towards white."""

_OUTLINE = "#555555"


def radius_of(shapes: Iterable[Shape]) -> float:
    """Return the radius of the ball about the cups' centre that holds all shapes."""
    return max(
        float(np.linalg.norm(faces, axis=-1).max())
        for shape in shapes
        for faces in shape.faces.values()
    )


class Scene:
    """Draws shapes on one grid as images; needs a display, see `opticcup_fem.plots.display`."""

    def __init__(
        self,
        grid: BodyGrid,
        radius: float,
        size: tuple[int, int],
        *,
        azimuth: float,
        elevation: float,
        scale: Normalize | None = None,
    ) -> None:
        """Put the camera up.

        Args:
            grid: The grid of the shapes.
            radius: Radius of the ball to be kept in the image.
            size: Width and height of the images in pixels.
            azimuth: Where the camera stands (rad).
            elevation: How high it stands above the horizontal (rad).
            scale: The scale of the grid's coloured quantity, if it has one.
        """
        self.grid, self.scale, self.elevation = grid, scale, elevation
        self._radius = radius
        self._plotter = pv.Plotter(off_screen=True, window_size=size, lighting="light kit")
        self._plotter.set_background("white")
        self._plotter.enable_anti_aliasing("ssaa")
        self._surfaces = {layer: layer_surfaces(grid, layer) for layer in grid.layers}
        self._thinnest = grid.thinnest
        self.turn(azimuth)

    def turn(self, azimuth: float) -> None:
        """Move the camera to another azimuth (rad)."""
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        direction = np.cos(self.elevation) * flat + np.sin(self.elevation) * np.array([0, 0, 1])
        camera = self._plotter.camera
        camera.view_angle = 24.0
        distance = 1.02 * self._radius / np.sin(np.deg2rad(camera.view_angle / 2))
        camera.position = tuple(distance * direction)
        camera.focal_point, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        camera.clipping_range = (distance - 2 * self._radius, distance + 2 * self._radius)

    def draw(self, shape: Shape, *, faded: bool = False) -> NDArray[np.uint8]:
        """Return the image of a shape, shape (height, width, 3).

        Args:
            shape: A shape on the grid.
            faded: Whether it is washed out, as what is no equilibrium must be.
        """
        for layer, (skin, walls) in self._surfaces.items():
            points = self.grid.layer_points(shape, layer)
            self._add(layer, points, skin, self._colours(shape, layer, skin, faded))
            if len(walls.triangles):
                # a section has the legend's own colours: it is not lit
                flat = self._colours(shape, layer, walls, faded) | {"lighting": False}
                self._add(f"{layer} cut", points, walls, flat)
                self._outline(layer, points, faded)
        self._plotter.render()
        image: NDArray[np.uint8] = self._plotter.screenshot(return_img=True)[..., :3]
        return image

    def _add(self, name: str, points: Floats, surface: Surface, colours: dict[str, Any]) -> None:
        """Add a surface to the picture, in the place of the one that had its name."""
        mesh = pv.PolyData.from_regular_faces(
            points[surface.source], surface.triangles.astype(np.int64), deep=True
        )
        mesh = mesh.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False
        )
        if "rgb" in colours:
            mesh.point_data["colour"] = colours["scalars"]
            colours = colours | {"scalars": "colour"}
        self._plotter.add_mesh(
            mesh,
            name=name,
            smooth_shading=True,
            ambient=0.3,
            diffuse=0.75,
            specular=0.1,
            reset_camera=False,
            render=False,
            **colours,
        )

    def _outline(self, layer: str, points: Floats, faded: bool) -> None:
        """Draw a line round a layer's sections; in its own colour it keeps a thin layer visible."""
        own = layer == self._thinnest and self.grid.quantity is None
        colour = style.layer_colour(layer, tuple(self.grid.layers)) if own else _OUTLINE
        for number, line in enumerate(self.grid.outlines(layer)):
            self._plotter.add_mesh(
                pv.lines_from_points(points[line]),
                name=f"{layer} outline {number}",
                color=colour,
                opacity=1 - _FADED if faded else 1.0,
                # of the finer image that is averaged down
                line_width=9.0 if own else 4.0,
                lighting=False,
                reset_camera=False,
                render=False,
            )

    def close(self) -> None:
        """Take the camera down."""
        self._plotter.close()

    def _colours(self, shape: Shape, layer: str, surface: Surface, faded: bool) -> dict[str, Any]:
        """Return the colour of a layer, or the colours of its surface's points."""
        whiter = _FADED if faded else 0.0
        if self.grid.quantity is None or self.scale is None:
            colour = np.array(to_rgb(style.layer_colour(layer, tuple(self.grid.layers))))
            return {"color": tuple(colour + whiter * (1 - colour))}
        values = self.grid.layer_values(shape, layer)[surface.source]
        painted = colour_map(self.grid.quantity)(self.scale(values))[:, :3]
        return {"scalars": painted + whiter * (1 - painted), "rgb": True}
