"""The commands that compute many cups: `sweep`, `reproduce`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from opticcup_fem.cli_tools import (
    FAILED_RUN,
    abort_all_ranks_on_a_bug,
    errors_as_one_line,
    one_error_for_all_ranks,
    prepare_folder,
    say,
)

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
        with abort_all_ranks_on_a_bug():
            from opticcup_fem.studies.sweep import command

            silent = quiet or not sys.stderr.isatty()
            outcome = command.run(study, folder, processes=processes, quiet=silent)
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

    NAME is fig1, fig2, fig3, fig4, s1 .. s6, readings, mass-off or surface. What is computed is
    kept in a cache: a run that was interrupted goes on, and a repeated one only draws.
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
        say(outcome.message)
