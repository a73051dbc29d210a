"""The commands that compute many cups: `sweep`, `reproduce`, `predict`, `hysteresis`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from opticcup_fem.cli_tools import (
    FAILED_RUN,
    abort_all_ranks_on_a_bug,
    errors_as_one_line,
    one_error_for_all_ranks,
    prepare_folder,
    say,
)
from opticcup_fem.errors import CaseError

StudyPath = Annotated[Path, typer.Argument(metavar="STUDY.toml", hidden=True)]
Processes = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Size of the pool of processes; default one a core."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only the outcome.")]


def sweep(
    study_path: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder; default results/ and the study's name."),
    ] = None,
    processes: Processes = None,
    part: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Only the K-th of N parts, into the cache: job arrays."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Compute a parameter study in parallel; write its table.

    STUDY.toml names a base case and axes along which its keys vary. Every point is kept in a
    cache, so that a study that was interrupted goes on where it was. Under mpirun the ranks share
    the work.
    """
    with errors_as_one_line():
        folder = Path("results") / study_path.stem if out is None else out
        with one_error_for_all_ranks():
            from opticcup_fem.studies.sweep.study_file import load_study

            study = load_study(study_path)
            prepare_folder(folder)
            from opticcup_fem.studies.sweep import command

            chosen = None if part is None else command.Part.parsed(part)
        with abort_all_ranks_on_a_bug():
            silent = quiet or not sys.stderr.isatty()
            outcome = command.run(study, folder, processes=processes, quiet=silent, part=chosen)
        say(outcome.message, err=outcome.failed > 0)
        if outcome.failed:
            raise typer.Exit(FAILED_RUN)


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Figures, e.g. fig1 fig4 s6; default all."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")] = Path(
        "results/report"
    ),
    experiment: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv", help="Measured points for Fig. 1: t_n, D_over_r, lambda_iov."
        ),
    ] = None,
    processes: Processes = None,
    quiet: Quiet = False,
) -> None:
    """Remake the paper's figures from computations; write report/index.html.

    NAME is fig1, fig2, fig3, fig4, s1 .. s6, readings, mass-off, coexistence or surface. What is
    computed is kept in a cache: a run that was interrupted goes on, and a repeated one only draws.
    """
    with errors_as_one_line():
        with one_error_for_all_ranks():
            from opticcup_fem.report import command

            chosen = command.checked_names(names or [])
            measured = None if experiment is None else command.read_experiment(experiment)
            prepare_folder(out)
        with abort_all_ranks_on_a_bug():
            silent = quiet or not sys.stderr.isatty()
            outcome = command.run(
                chosen, out, experiment=measured, processes=processes, quiet=silent
            )
        say(outcome.message, err=outcome.missing > 0)
        if outcome.missing:
            raise typer.Exit(FAILED_RUN)


def predict(
    radius: Annotated[float, typer.Option("--R", metavar="UM", help="R in micrometres.")] = 50.0,
    thickness: Annotated[float, typer.Option("--h", metavar="UM", help="h in micrometres.")] = 10.0,
    alpha: Annotated[float, typer.Option(metavar="DEG", help="Opening angle in degrees.")] = 40.0,
    m: Annotated[float, typer.Option("--m", help="Thickness ratio h_ECM/h_IOV.")] = 1 / 9,
    n: Annotated[float, typer.Option("--n", help="Modulus ratio mu_ECM/mu_IOV.")] = 50.0,
    nu: Annotated[float, typer.Option(help="Poisson ratio.")] = 0.45,
    iov: Annotated[float, typer.Option(help="Growth rate of the IOV.")] = 5.0,
    oov: Annotated[float, typer.Option(help="Growth rate of the OOV.")] = 1.5,
    mass_change: Annotated[
        bool, typer.Option(help="Density-preserving growth: stress factor e^2.")
    ] = True,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder.")] = Path("results/predict"),
    processes: Processes = None,
    quiet: Quiet = False,
) -> None:
    """Say what becomes of one geometry, and what 10 % more or less of each parameter does.

    Normal or abnormal, at which time, by which mode, how far from the boundary; a tornado plot.
    The axisymmetric path and its stability are computed, not read off the scaling laws.
    """
    with errors_as_one_line():
        with one_error_for_all_ranks():
            for name, value in (("--R", radius), ("--h", thickness)):
                if not value > 0:
                    raise CaseError(f"{name} = {value:g} is not possible: give a length above 0")
            from opticcup_fem.studies import predict as study

            tables: dict[str, dict[str, Any]] = {
                "shape": {"opening_angle_deg": alpha},
                "material": {"thickness_ratio": m, "modulus_ratio": n, "poisson_ratio": nu},
                "growth": {"iov": iov, "oov": oov, "mass_change": mass_change},
                "output": {"times": [0.5, 1.0]},
            }
            geometry = study.Geometry(radius, thickness, tables)
            geometry.case()
            prepare_folder(out)
        with abort_all_ranks_on_a_bug():
            silent = quiet or not sys.stderr.isatty()
            forecast = study.run(geometry, out, processes=processes, quiet=silent)
        if forecast is not None:
            say("\n".join([*forecast.sentences(), f"plot and table in {out}"]))


def hysteresis(
    case_path: Annotated[Path, typer.Argument(metavar="CASE.toml", hidden=True)],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder.")] = Path("results/hysteresis"),
    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="TABLE.KEY=VALUE", help="Override a key; repeatable."),
    ] = [],
    ratio: Annotated[
        list[float],
        typer.Option(metavar="R/h", help="Carry the slit there; repeatable, slender first."),
    ] = [],
    at: Annotated[
        float | None, typer.Option(metavar="T", help="t_n of that; default the last output time.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Follow a buckled cup back in time and to thicker shells, beside the round one.

    The case must resist contact and buckle before run.t_end.
    """
    with errors_as_one_line():
        with one_error_for_all_ranks():
            from opticcup_fem.case import load_case

            case = load_case(case_path, set_)
            prepare_folder(out)
        with abort_all_ranks_on_a_bug():
            from opticcup_fem.studies import hysteresis as study

            outcome = study.run(
                case, out, ratios=ratio, at=at, quiet=quiet or not sys.stderr.isatty()
            )
        say(outcome.message, err=not outcome.ok)
        if not outcome.ok:
            raise typer.Exit(FAILED_RUN)
