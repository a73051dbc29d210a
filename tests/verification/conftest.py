"""What the verification tests share."""

import numpy as np
import pytest

from opticcup_fem.equilibrium import newton


@pytest.fixture(autouse=True)
def patient_newton(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch the guard against wandering off.

    It compares residuals with the smallest one so far.  A step of a dead load starts in
    equilibrium, with the residual of a small load increment; the first full Newton step raises it
    by six orders of magnitude, and good solves end far above the first residual for a while.
    """
    monkeypatch.setattr(newton, "WANDERING", np.inf)
