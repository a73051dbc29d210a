"""A run's path over a reference path, unstable parts of the reference included."""

from pathlib import Path

from matplotlib.figure import Figure

from opticcup_fem.plots import style
from opticcup_fem.plots.curves import draw_path, mark_events
from opticcup_fem.records import COMPARISON, read_events, read_path

_NAMES = ("D_over_r", "lambda_iov", "apex_height_over_R")


@style.styled
def compare(run_dir: str | Path, reference_csv: str | Path, out: str | Path | None = None) -> Path:
    """Draw D/r, lambda_IOV and c of a run over a reference path.

    Args:
        run_dir: The run's folder.
        reference_csv: A path with columns t_n, D_over_r, lambda_iov, apex_height_over_R; t_n may
            turn back.
        out: The picture; comparison.png in the run's folder by default.

    Returns:
        The picture's path.
    """
    import pandas as pd

    run_dir = Path(run_dir)
    path, events = read_path(run_dir), read_events(run_dir)
    reference = pd.read_csv(reference_csv)
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    panels = figure.subplots(1, len(_NAMES))
    for axes, name in zip(panels, _NAMES, strict=True):
        axes.plot(
            reference["t_n"], reference[name], color=style.REFERENCE, linewidth=3.5,
            label="reference (with unstable parts)", solid_capstyle="round",
        )  # fmt: skip
        draw_path(axes, path, name, style.CURVES[0], label="this run")
        axes.plot(path["t_n"], path[name], ".", color=style.CURVES[0], markersize=4)
        mark_events(axes, path, name, events, style.INK)
        axes.set_xlim(0.0, float(max(path["t_n"].max(), 0.02)))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return style.save(figure, Path(out) if out is not None else run_dir / COMPARISON)
