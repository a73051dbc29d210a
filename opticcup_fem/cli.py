"""The command line: parse, call, and turn every error into one line and an exit code.

Nothing heavy is imported at the top: `--help` must answer at once.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import typer

import opticcup_fem
from opticcup_fem import cli_pictures, cli_studies
from opticcup_fem.cli_tools import (
    FAILED_RUN,
    INTERRUPTED,
    abort_all_ranks_on_a_bug,
    errors_as_one_line,
    one_error_for_all_ranks,
    prepare_folder,
    rank,
    say,
)
from opticcup_fem.errors import CaseError

if TYPE_CHECKING:
    from opticcup_fem.case import Case

app = typer.Typer(
    name="opticcup",
    help="Growth and elastic instabilities of the optic cup, computed with FEniCSx.",
    no_args_is_help=True,
    add_completion=False,
    # Plain text: an error is one line, also in a log file.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

STUDIES = (
    cli_studies.sweep,
    cli_studies.reproduce,
    cli_studies.predict,
    cli_studies.hysteresis,
)
PICTURES = (cli_pictures.movie, cli_pictures.view, cli_pictures.pair)
for command in (*STUDIES, *PICTURES):
    app.command()(command)

CasePath = Annotated[Path, typer.Argument(metavar="CASE.toml", hidden=True)]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="TABLE.KEY=VALUE",
        help="Override a key of the case, e.g. shape.radius_over_thickness=15; repeatable.",
    ),
]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code, the same one on every MPI rank.

    Args:
        arguments: Arguments after the program's name; those of the process by default.
    """
    first_rank = rank() == 0
    if not first_rank:
        # Also the help and the version are printed once.
        sys.stdout = open(os.devnull, "w", encoding="utf-8")
    try:
        code = app(arguments, prog_name="opticcup", standalone_mode=False)
    except click.ClickException as error:
        if first_rank:
            error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        if first_rank:
            typer.echo("interrupted", err=True)
        code = INTERRUPTED
    sys.exit(code)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"opticcup_fem {opticcup_fem.__version__}")
        raise typer.Exit


@app.command()
def run(
    case_path: Annotated[
        Path | None, typer.Argument(metavar="CASE.toml", hidden=True, show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Run folder; default results/ and the case's name."),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Go on with the interrupted run in this folder."),
    ] = None,
    set_: Overrides = [],
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="Short for --set run.model=NAME.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the outcome.")] = False,
) -> None:
    """Grow a cup; write curves, events, fields, picture.

    CASE.toml is the case; every accepted state is written to the run folder as it is computed.
    """
    with errors_as_one_line():
        overrides = [*set_, *([f"run.model={model}"] if model is not None else [])]
        with one_error_for_all_ranks():
            if resume is not None:
                folder = resume
                case = _case_to_resume(resume, case_path, out, overrides)
            elif case_path is None:
                raise CaseError("name a case, CASE.toml, or an interrupted run with --resume DIR")
            else:
                folder = Path("results") / case_path.stem if out is None else out
                case = _load(case_path, overrides)
            prepare_folder(folder)
        with abort_all_ranks_on_a_bug():
            from opticcup_fem.studies.run import run as grow

            hushed = quiet or not sys.stderr.isatty()
            summary = grow(case, folder, quiet=hushed, resume=resume is not None)
        say(summary.message, err=not summary.ok)
        if not summary.ok:
            raise typer.Exit(FAILED_RUN)


@app.command()
def verify(
    case_path: CasePath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder; default results/verify- and the case's name."),
    ] = None,
    set_: Overrides = [],
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the outcome.")] = False,
) -> None:
    """Run a case on the surface and on the meridian model; print and plot their differences."""
    with errors_as_one_line():
        folder = Path("results") / f"verify-{case_path.stem}" if out is None else out
        with one_error_for_all_ranks():
            case = _load(case_path, set_)
            prepare_folder(folder)
        with abort_all_ranks_on_a_bug():
            from opticcup_fem.studies import verify as study

            outcome = study.run(case, folder, quiet=quiet or not sys.stderr.isatty())
        say(outcome.message, err=not outcome.ok)
        if not outcome.ok:
            raise typer.Exit(FAILED_RUN)


@app.command()
def theory(case_path: CasePath, set_: Overrides = []) -> None:
    """Print what the scaling laws predict for a case.

    The natural curvature of the cap over time, the critical values and times of the events, and
    whether the cup becomes normal or abnormal.
    """
    with errors_as_one_line():
        with one_error_for_all_ranks():
            case = _load(case_path, set_)
            from opticcup_fem.case.checks import require_cup

            require_cup(case, "the scaling laws are")
        from opticcup_fem.theory import prediction_report

        say(prediction_report(case))


@app.command()
def mesh(
    case_path: CasePath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.msh", help="Gmsh file; default the case's name."),
    ] = None,
    set_: Overrides = [],
) -> None:
    """Write the surface mesh of a case as a Gmsh file.

    Physical groups: cap, oov, interface, or cap or disk, rim. Lengths are in units of R.
    """
    with errors_as_one_line():
        path = Path(f"{case_path.stem}.msh") if out is None else out
        with one_error_for_all_ranks():
            case = _load(case_path, set_)
            if path.suffix != ".msh":
                raise CaseError(f"{path}: meshes are Gmsh files; give --out a name ending in .msh")
            prepare_folder(path.parent)
        from mpi4py import MPI

        from opticcup_fem.mesh import write_msh
        from opticcup_fem.studies.model import mesh_of

        with abort_all_ranks_on_a_bug():
            surface_mesh = mesh_of(case, MPI.COMM_WORLD)
            write_msh(surface_mesh, path)
            report = surface_mesh.report()
        say(f"{path}: {report}")


def _case_to_resume(
    folder: Path, case_path: Path | None, out: Path | None, overrides: Sequence[str]
) -> Case:
    """Return the case of an interrupted run; whatever else was given must agree with it."""
    from opticcup_fem.case import parse_case
    from opticcup_fem.checkpoint import CHECKPOINT, read_checkpoint
    from opticcup_fem.records import CASE

    if out is not None and out != folder:
        raise CaseError(f"--resume {folder} writes there: leave --out {out} away")
    if not any((folder / name).is_file() for name in (CASE, CHECKPOINT)):
        raise CaseError(f"{folder} holds no run to resume: there is no {CASE} in it")
    case = parse_case(json.loads(read_checkpoint(folder).case), str(folder / CHECKPOINT))
    written = folder / CASE  # not there yet if the run was killed at once
    if written.exists() and _load(written, []) != case:
        raise CaseError(
            f"{written} has been changed since the run began: change it back, or run it as a case "
            "in another folder"
        )
    if (case_path or overrides) and _load(case_path or written, overrides) != case:
        raise CaseError(
            f"{folder} holds the run of another case: resume it with --resume alone, or run this "
            "case in another folder"
        )
    return case


def _load(path: Path, overrides: Sequence[str]) -> Case:
    from opticcup_fem.case import load_case

    return load_case(path, overrides)
