"""Errors carry fields for programs and a sentence for people, also across processes."""

import pickle

import pytest

from opticcup_fem.errors import (
    CaseError,
    ClosureBreakdown,
    ConvergenceError,
    MeshError,
    OpticCupError,
)

CONVERGENCE = ConvergenceError("DIVERGED_MAX_IT", 0.4, 17, 12, 3.1e-5)
BREAKDOWN = ClosureBreakdown("paper", "oov", -0.09, (0.6, 0.0, 0.75), 0.742)


def test_every_error_is_caught_by_the_base():
    for error in (CaseError("x"), MeshError("x"), CONVERGENCE, BREAKDOWN):
        assert isinstance(error, OpticCupError)
    assert isinstance(CaseError("x"), ValueError)


def test_convergence_error_says_where_why_and_what_next():
    message = str(CONVERGENCE)
    for part in ("t_n = 0.4", "step 17", "DIVERGED_MAX_IT", "12 iterations", "3.1e-05"):
        assert part in message
    assert "solver.min_step" in message
    assert (CONVERGENCE.reason, CONVERGENCE.step) == ("DIVERGED_MAX_IT", 17)


def test_closure_breakdown_says_layer_height_and_place():
    message = str(BREAKDOWN)
    for part in ("paper closure", "t_n = 0.742", "layer oov", "xi = -0.09", "(0.6, 0, 0.75)"):
        assert part in message
    assert BREAKDOWN.position == (0.6, 0.0, 0.75)


def test_closure_breakdown_gets_its_time_later():
    raised = ClosureBreakdown("layer-stretch", "iov", 0.01, (0, 0, 1))
    assert raised.t_n is None
    assert "t_n" not in str(raised)
    dated = raised.at(0.3)
    assert dated.t_n == 0.3
    assert "t_n = 0.3" in str(dated)
    assert (dated.layer, dated.height, dated.position) == ("iov", 0.01, (0.0, 0.0, 1.0))


@pytest.mark.parametrize("error", [CONVERGENCE, BREAKDOWN, MeshError("m"), CaseError("c")])
def test_errors_survive_pickling_between_ranks(error):
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)
