"""The command line: parse, call, and turn every error into one line and an exit code.

Nothing heavy is imported at the top: `--help` must answer at once.
"""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import typer

import opticcup_fem
from opticcup_fem.errors import CaseError, MeshError, OpticCupError

if TYPE_CHECKING:
    from opticcup_fem.case import Case
    from opticcup_fem.studies.outcome import RunSummary

FAILED_RUN, BAD_INPUT = 1, 2

app = typer.Typer(
    name="opticcup",
    help="Growth and elastic instabilities of the optic cup, computed with FEniCSx.",
    no_args_is_help=True,
    add_completion=False,
    # Plain text: an error is one line, also in a log file.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

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
    first_rank = _rank() == 0
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
        code = FAILED_RUN
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
    case_path: CasePath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Run folder; default results/ and the case's name."),
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
    with _errors_as_one_line():
        overrides = [*set_, *([f"run.model={model}"] if model is not None else [])]
        folder = Path("results") / case_path.stem if out is None else out
        with _one_error_for_all_ranks():
            case = _load(case_path, overrides)
            _prepare_folder(folder)
        with _abort_all_ranks_on_a_bug():
            grow = _study(case.run.model)
            summary = grow(case, folder, quiet=quiet or not sys.stderr.isatty())
        _say(summary.message, err=not summary.ok)
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
    with _errors_as_one_line():
        folder = Path("results") / f"verify-{case_path.stem}" if out is None else out
        with _one_error_for_all_ranks():
            case = _load(case_path, set_)
            _prepare_folder(folder)
        with _abort_all_ranks_on_a_bug():
            from opticcup_fem.studies import verify as study

            outcome = study.run(case, folder, quiet=quiet or not sys.stderr.isatty())
        _say(outcome.message, err=not outcome.ok)
        if not outcome.ok:
            raise typer.Exit(FAILED_RUN)


@app.command()
def theory(case_path: CasePath, set_: Overrides = []) -> None:
    """Print what the scaling laws predict for a case.

    The natural curvature of the cap over time, the critical values and times of the events, and
    whether the cup becomes normal or abnormal.
    """
    with _errors_as_one_line():
        with _one_error_for_all_ranks():
            case = _load(case_path, set_)
            from opticcup_fem.case.checks import require_cup

            require_cup(case, "the scaling laws are")
        from opticcup_fem.theory import prediction_report

        _say(prediction_report(case))


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
    with _errors_as_one_line():
        path = Path(f"{case_path.stem}.msh") if out is None else out
        with _one_error_for_all_ranks():
            case = _load(case_path, set_)
            if path.suffix != ".msh":
                raise CaseError(f"{path}: meshes are Gmsh files; give --out a name ending in .msh")
            _prepare_folder(path.parent)
        from mpi4py import MPI

        from opticcup_fem.mesh import write_msh
        from opticcup_fem.studies.model import mesh_of

        with _abort_all_ranks_on_a_bug():
            surface_mesh = mesh_of(case, MPI.COMM_WORLD)
            write_msh(surface_mesh, path)
            report = surface_mesh.report()
        _say(f"{path}: {report}")


def _study(model: str) -> Callable[..., RunSummary]:
    """Return what grows a cup on the discretisation ``run.model``."""
    if model == "meridian":
        from opticcup_fem.studies import meridian

        return meridian.run
    from opticcup_fem.studies import cup

    return cup.run


def _load(path: Path, overrides: Sequence[str]) -> Case:
    from opticcup_fem.case import load_case

    return load_case(path, overrides)


def _prepare_folder(folder: Path) -> None:
    """Make a folder and try to write in it now, not after an hour of computing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CaseError(
            f"{folder}: cannot write there ({error.strerror}); give another place with --out"
        ) from None


@contextmanager
def _errors_as_one_line() -> Iterator[None]:
    try:
        yield
    except OpticCupError as error:
        _say(f"error: {error}", err=True)
        bad_input = isinstance(error, CaseError | MeshError)
        raise typer.Exit(BAD_INPUT if bad_input else FAILED_RUN) from None


@contextmanager
def _one_error_for_all_ranks() -> Iterator[None]:
    """Raise the first rank's error on every rank: none may wait in a collective for the others."""
    error: OpticCupError | None = None
    try:
        yield
    except OpticCupError as own:
        error = own
    if _is_under_mpi():
        from mpi4py import MPI

        errors = MPI.COMM_WORLD.allgather(error)
        error = next((one for one in errors if one is not None), None)
    if error is not None:
        raise error


@contextmanager
def _abort_all_ranks_on_a_bug() -> Iterator[None]:
    """Keep an unforeseen exception on one rank from leaving the others waiting for ever."""
    try:
        yield
    except OpticCupError:
        raise
    except Exception:
        if _is_under_mpi():
            from mpi4py import MPI

            traceback.print_exc()
            sys.stderr.flush()
            MPI.COMM_WORLD.Abort(FAILED_RUN)
        raise


def _say(text: str, err: bool = False) -> None:
    if _rank() == 0:
        typer.echo(text, err=err)


def _is_under_mpi() -> bool:
    """Tell whether a launcher of Open MPI, MPICH or Slurm started this process."""
    return any(name in os.environ for name in ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"))


def _rank() -> int:
    if not _is_under_mpi():
        return 0
    # Starting MPI here also makes every rank wait for the others when it ends: otherwise the
    # first to exit with an error has the launcher kill the one that is about to print it.
    from mpi4py import MPI

    return MPI.COMM_WORLD.rank
