"""States kept in a run folder.

What matters: what is read is what was written, whatever ends the writing leaves the earlier states
readable, and a folder without states, or with broken ones, is one sentence.
"""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from opticcup_fem.errors import CaseError
from opticcup_fem.records import RunFolder
from opticcup_fem.reordering import Reordering
from opticcup_fem.snapshot import Snapshot
from opticcup_fem.states import States
from tests.support.shapes import cup, deformed, sphere_mesh


@pytest.fixture(scope="module")
def states() -> list[Snapshot]:
    """Return a sphere and a cup with uneven fields in their layers."""
    sphere, rng = sphere_mesh(0.5), np.random.default_rng(3)
    shapes = [sphere, deformed(sphere, cup, t_n=1 / 3)]
    return [
        replace(
            shape,
            thickness_stretch={
                layer: value * rng.uniform(0.5, 2, value.shape)
                for layer, value in shape.thickness_stretch.items()
            },
            stress={
                layer: value + rng.normal(size=value.shape) for layer, value in shape.stress.items()
            },
        )
        for shape in shapes
    ]


def written(path: Path, states: list[Snapshot]) -> Path:
    """Write states into a run folder, a jump between them."""
    with RunFolder(path, "") as folder:
        for k, state in enumerate(states):
            folder.write_state(state, jump=k > 0)
    return path


def test_what_is_read_is_what_was_written(tmp_path: Path, states: list[Snapshot]) -> None:
    """Mesh and positions to the last digit; what pictures need in single precision."""
    found = States(written(tmp_path, states))
    assert len(found) == len(found[:]) == 2
    assert list(found.t_n) == [0.0, 1 / 3]
    assert list(found.jump) == [False, True]
    for state, back in zip(states, found, strict=True):
        assert back.t_n == state.t_n
        assert (back.layers, back.region_ids) == (state.layers, state.region_ids)
        for name in ("reference", "position", "cells", "region", "orientation"):
            np.testing.assert_array_equal(getattr(back, name), getattr(state, name))
        for name in ("thickness_stretch", "stress", "faces"):
            one, other = getattr(back, name), getattr(state, name)
            assert set(one) == set(other)
            for key, value in one.items():
                np.testing.assert_allclose(value, other[key], rtol=2e-7, atol=2e-7)
    assert found[-1].t_n == 1 / 3
    with pytest.raises(IndexError):
        found[2]


def test_growth_is_kept_where_it_is_balanced(tmp_path: Path, states: list[Snapshot]) -> None:
    """Density and growth factor of a layer, NaN outside of it; nothing where none is balanced."""
    rho = np.linspace(0.5, 2.0, states[1].cells.size).reshape(states[1].cells.shape)
    rho[0] = np.nan
    grown = replace(states[1], growth={"rho_iov": rho, "e_iov": 2 * rho})
    read = States(written(tmp_path, [states[0], grown]))
    assert read[0].growth == {}
    np.testing.assert_allclose(read[1].growth["rho_iov"], rho, rtol=1e-6)
    np.testing.assert_allclose(read[1].growth["e_iov"], 2 * rho, rtol=1e-6)


def test_contact_is_kept_where_it_is_resisted(tmp_path: Path, states: list[Snapshot]) -> None:
    """Single precision, in the order of the nodes, also when these are put into another order."""
    force = np.random.default_rng(5).normal(size=states[1].position.shape)
    pushed = replace(states[1], contact_traction=force)
    read = States(written(tmp_path, [states[0], pushed]))
    assert read[0].contact_traction is None
    np.testing.assert_allclose(read[1].contact_traction, force, rtol=1e-6)
    turned = Reordering(pushed, np.arange(len(pushed.cells))[::-1])(pushed)
    for one, other in zip(turned.position, turned.contact_traction, strict=True):
        node = int(np.argmin(np.linalg.norm(pushed.position - one, axis=1)))
        np.testing.assert_array_equal(other, force[node])


def test_a_killed_writer_leaves_the_earlier_states(tmp_path: Path, states: list[Snapshot]) -> None:
    """An unfinished file has another name; what comes after a gap is not counted."""
    folder = written(tmp_path, states) / "states"
    whole = (folder / "00001.h5").read_bytes()
    (folder / "00001.h5").unlink()
    (folder / ".00001.h5").write_bytes(whole[: len(whole) // 2])
    assert list(States(tmp_path).t_n) == [0.0]


def test_an_earlier_runs_states_go(tmp_path: Path, states: list[Snapshot]) -> None:
    """Also unfinished ones; a user's file in the folder stays."""
    folder = written(tmp_path, states) / "states"
    (folder / "mine.txt").write_text("mine")
    (folder / ".00002.h5").write_text("half")
    RunFolder(tmp_path, "", overwrite=True).close()
    assert [file.name for file in folder.iterdir()] == ["mine.txt"]
    with pytest.raises(CaseError, match="holds no states"):
        States(tmp_path)


def test_what_cannot_be_read_is_one_sentence(tmp_path: Path, states: list[Snapshot]) -> None:
    """No folder, a broken file, another layout."""
    with pytest.raises(CaseError, match="no such run folder"):
        States(tmp_path / "absent")
    file = written(tmp_path, states) / "states" / "00000.h5"
    with h5py.File(file, "a") as opened:
        opened.attrs["format"] = 99
    with pytest.raises(CaseError, match="layout 99"):
        States(tmp_path)
    file.write_bytes(b"not HDF5")
    with pytest.raises(CaseError, match="cannot be read as HDF5") as caught:
        States(tmp_path)
    assert "\n" not in str(caught.value)
