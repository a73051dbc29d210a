"""Gmsh without side effects: a session that leaves a caller's own session as it was."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from opticcup_fem.errors import MeshError

__all__ = ["gmsh_model"]

_MODEL = "opticcup_fem"


@contextmanager
def gmsh_model(**options: float) -> Iterator[Any]:
    """Yield the ``gmsh`` module with a fresh, empty model.

    Args:
        options: Options to set for the block, with "_" for the dot: ``Mesh_Algorithm=6``.

    Raises:
        MeshError: Gmsh is missing, or reports an error inside the block.
    """
    try:
        import gmsh  # a slow import that only the meshing rank needs
    except ImportError as error:
        raise MeshError(f"Gmsh's Python module cannot be loaded ({error}); install it") from error

    own = not gmsh.isInitialized()
    if own:
        # interruptible: leave Python's own handler of ctrl-C in place
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    previous_model = gmsh.model.getCurrent()
    wanted = {"General.Terminal": 0.0} | {k.replace("_", "."): v for k, v in options.items()}
    previous = {name: gmsh.option.getNumber(name) for name in wanted}
    try:
        for name, value in wanted.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add(_MODEL)
        yield gmsh
    except MeshError:
        raise
    except Exception as error:
        # gmsh raises bare Exception, with its log as the only information
        if type(error) is not Exception:
            raise
        raise MeshError(f"Gmsh failed: {error}; try other cell sizes or another seed") from error
    finally:
        if own:
            gmsh.finalize()
        else:
            gmsh.model.setCurrent(_MODEL)
            gmsh.model.remove()
            if previous_model in gmsh.model.list():
                gmsh.model.setCurrent(previous_model)
            for name, value in previous.items():
                gmsh.option.setNumber(name, value)
