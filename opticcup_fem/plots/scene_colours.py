"""What colours of a body mean, where they mean a quantity and not a layer."""

from collections.abc import Iterable, Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Colormap, Normalize, SymLogNorm

from opticcup_fem.snapshot import Floats

COLOUR_MAPS = {"lambda3": "viridis", "stress": "RdBu_r", "contact": "YlOrRd", "density": "cividis"}

UNKNOWN = "#d9d9d9"
"""Where a quantity is not known."""

COLOUR_LABELS = {
    "lambda3": r"thickness stretch $\lambda_3$",
    "stress": r"mean in-plane stress / $\mu_\mathrm{IOV}$",
    "density": r"density $\rho/\rho_0$",
    "contact": r"contact force per reference area / $\mu_\mathrm{IOV}$",
}


def colour_scale(quantity: str, values: Iterable[Mapping[str, Floats]]) -> Normalize:
    """Return the scale of colours that serves all states of a run.

    Stresses have the same colour strength in tension and in compression; their scale is linear up
    to mu_IOV and logarithmic beyond, as the ECM's are so much larger than the tissue's.  Forces of
    contact, which crowd on a few places, are logarithmic from a hundredth of the largest.

    Args:
        quantity: A key of `opticcup_fem.plots.body.QUANTITIES`.
        values: For each state the values of each layer.
    """
    if quantity == "contact":  # on a small part of the surface, and in few states
        largest = max((float(v.max()) for state in values for v in state.values()), default=0.0)
        largest = max(largest, 1e-3)
        return SymLogNorm(linthresh=largest / 100, vmin=0.0, vmax=largest, base=10)
    known = [v[np.isfinite(v)] for state in values for v in state.values()]
    limits = np.array([np.percentile(v, [1, 99]) for v in known if v.size])
    low, high = float(limits[:, 0].min()), float(limits[:, 1].max())
    if quantity == "stress":
        largest = max(abs(low), abs(high), 2.0)
        return SymLogNorm(linthresh=1.0, vmin=-largest, vmax=largest, base=10)
    return Normalize(low, max(high, low + 1e-3))


def colour_map(quantity: str) -> Colormap:
    """Return the colours of a quantity."""
    return mpl.colormaps[COLOUR_MAPS[quantity]].with_extremes(bad=UNKNOWN)
