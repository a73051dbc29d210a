# shellcheck shell=bash
# docker/run where python3 has dolfinx: a virtual environment adds what is missing.
# shellcheck disable=SC2154  # project, recipe, cache and partial are set by its other files

# Prints what identifies the Python and its dolfinx, or fails.  The version is read without an
# import: that would start MPI.
native_dolfinx() {
    [ "${OPTICCUP_NATIVE:-1}" != 0 ] && command -v python3 >/dev/null || return 1
    python3 - 2>/dev/null <<'PY'
import importlib.util, sys
sys.path[:] = [folder for folder in sys.path if folder]  # the working folder is not searched
if importlib.util.find_spec("dolfinx") is None:
    sys.exit(1)
from importlib.metadata import version
number = version("fenics-dolfinx")
if tuple(int(part) for part in number.split(".")[:2]) < (0, 9):
    sys.exit(1)
print(sys.executable, sys.version, number)
PY
}

make_native_venv() {
    local venv=$1
    begin_setup
    if [ ! -e "$venv/.complete" ]; then
        say "adding the missing Python packages to the dolfinx of $(command -v python3), in $venv."
        rm -rf "$venv"
        logged python3 -c 'import dolfinx, gmsh, slepc4py; from petsc4py import PETSc
assert PETSc.ScalarType(0).dtype.kind == "f", "PETSc is built for complex numbers"' ||
            fail_setup "the dolfinx of python3 does not serve: it must import beside gmsh," \
                "petsc4py and slepc4py and have real numbers; OPTICCUP_NATIVE=0 uses Debian's"
        logged native_venv_steps "$venv" || fail_setup "pip could not add the missing packages"
        write_command "$venv" "$venv"
        touch "$venv/.complete"
    fi
    prune native
    end_setup
}

# The site folders of python3 are named in a .pth file: if it is a virtual environment or Conda's,
# "system site packages" would not mean its own.
native_venv_steps() {
    python3 -m venv --system-site-packages "$1" &&
    python3 -c 'import site
for folder in site.getsitepackages():
    print(f"import site; site.addsitedir({folder!r})")' >"$partial/parent.pth" &&
    cp "$partial/parent.pth" "$("$1/bin/python3" -c 'import site; print(site.getsitepackages()[0])')" &&
    "$1/bin/python3" -c "$missing_dependencies" "$project/pyproject.toml" >"$partial/needed.txt" &&
    "$1/bin/python3" -m pip install -r "$project/docker/requirements.txt" \
        -r "$project/docker/requirements-docs.txt" -r "$partial/needed.txt"
}

# What is there is left alone: asked for all, pip would add the vtk that Debian's pyvista, in its
# eyes, lacks.
readonly missing_dependencies='
import importlib.metadata, sys, tomllib
from pip._vendor.packaging.requirements import Requirement

def missing(needed):
    try:
        return importlib.metadata.version(needed.name) not in needed.specifier
    except importlib.metadata.PackageNotFoundError:
        return True

with open(sys.argv[1], "rb") as file:
    project = tomllib.load(file)["project"]
lines = project["dependencies"] + project["optional-dependencies"]["test"]
print(*(line for line in lines if missing(Requirement(line))), sep="\n")
'

run_native() {
    local identity=$1 name venv
    shift
    name=native-$(cat - "$project"/docker/requirements*.txt "$project/pyproject.toml" \
        <<<"$recipe $identity" | fingerprint)
    # A virtual environment cannot be renamed here, so that a file tells that it is whole.
    venv=$cache/$name
    hold "$name"
    [ -e "$venv/.complete" ] || make_native_venv "$venv"
    export OPTICCUP_INSIDE=1 PATH="$venv/bin:$PATH" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
    export PYTHONPATH="$project${PYTHONPATH:+:$PYTHONPATH}"
    # mpirun may start more processes than there are cores.
    export PRTE_MCA_rmaps_default_mapping_policy=${PRTE_MCA_rmaps_default_mapping_policy:-:oversubscribe}
    exec "$@"
}
