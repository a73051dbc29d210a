"""The array type of the theory, and the conversion that every function starts with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def floats(*values: npt.ArrayLike) -> tuple[FloatArray, ...]:
    """Return the values as arrays of doubles, so that every formula broadcasts.

    >>> floats(1, [2, 3])
    (array(1.), array([2., 3.]))
    """
    return tuple(np.asarray(value, dtype=np.float64) for value in values)
