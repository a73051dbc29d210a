#!/usr/bin/env bash
# Builds the image and its test stage, and tries them: a run of another user on a mounted folder, a
# run on two processes, the quick tests.  With docker or podman where one of them runs containers,
# else with Buildah (chroot isolation, as root) on a base that mmdebstrap makes.
#
#   docker/test_image.sh [--no-tests]
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'docker/test_image.sh: %s\n' "$*" >&2; }

engine=buildah
for candidate in docker podman; do
    if command -v "$candidate" >/dev/null && "$candidate" run --rm debian:trixie-slim true 2>/dev/null; then
        engine=$candidate
        break
    fi
done
if [ "$engine" = buildah ]; then
    for tool in buildah mmdebstrap; do
        command -v "$tool" >/dev/null ||
            { say "no engine runs here, and there is no $tool: apt-get install buildah mmdebstrap"; exit 1; }
    done
fi
say "with $engine"

work=$(mktemp -d)
containers=()
clean() {
    [ ${#containers[@]} -eq 0 ] || buildah rm "${containers[@]}" >/dev/null
    rm -rf "$work"
}
trap clean EXIT
# where the other user of the image may write
mkdir -m 0777 "$work/cases"
cp demos/*.toml "$work/cases"

base=()
if [ "$engine" = buildah ]; then
    base=(--build-arg DEBIAN=localhost/opticcup-base)
    if ! buildah inspect --type image localhost/opticcup-base >/dev/null 2>&1; then
        say "making the base"
        mmdebstrap --variant=minbase trixie "$work/base.tar"
        container=$(buildah from scratch)
        buildah add "$container" "$work/base.tar" / >/dev/null
        buildah commit --rm "$container" localhost/opticcup-base >/dev/null
        rm "$work/base.tar"
    fi
fi

# A certificate bundle, where pip needs one of its own.
certificates=()
if [ -n "${PIP_CERT:-}" ] && [ "$engine" != docker ]; then
    certificates=(--volume "$PIP_CERT:/certificates.pem:ro" --build-arg PIP_CERT=/certificates.pem)
fi

build() { # STAGE TAG
    case $engine in
        docker) docker build --target "$1" -t "$2" -f docker/Dockerfile . ;;
        podman) podman build "${certificates[@]}" --target "$1" -t "$2" -f docker/Dockerfile . ;;
        buildah)
            buildah bud --isolation=chroot --network=host --pull-never --layers "${base[@]}" \
                "${certificates[@]}" --target "$1" -t "$2" -f docker/Dockerfile .
            ;;
    esac
}

# try TAG CMD...: as a user that the image does not know, with the folder of cases.
try() {
    local tag=$1 container
    shift
    if [ "$engine" = buildah ]; then
        container=$(buildah from --pull-never "$tag")
        containers+=("$container")
        buildah run --isolation=chroot --user 4321:4321 --volume "$work/cases:/cases" \
            "$container" -- "$@"
    else
        "$engine" run --rm --user 4321:4321 --volume "$work/cases:/cases" --entrypoint "$1" "$tag" "${@:2}"
    fi
}

say "building the image"
build image opticcup
case $engine in
    buildah) size=$(buildah images --json opticcup | sed -n 's/.*"size": "\(.*\)".*/\1/p' | head -n 1) ;;
    *) size=$("$engine" image inspect --format '{{.Size}}' opticcup) ;;
esac
say "size: $size"

say "a run of another user, in a mounted folder"
try opticcup opticcup run /cases/chick.toml --out /cases/one --quiet --set run.t_end=0.02 \
    --set mesh.cell_size_interface=0.18 --set mesh.cell_size_oov=0.45
[ "$(stat -c %u "$work/cases/one/path.csv")" = 4321 ]
[ -s "$work/cases/one/summary.png" ]

say "a run on two processes"
try opticcup mpirun -n 2 opticcup run /cases/chick.toml --out /cases/two --quiet --set run.t_end=0.02 \
    --set mesh.cell_size_interface=0.18 --set mesh.cell_size_oov=0.45
# the same states, in the digits that do not depend on the order of sums
compare='import sys
import pandas as pd
one, two = (pd.read_csv(f"/cases/{name}/path.csv") for name in ("one", "two"))
difference = abs(one[["t_n", "D_over_r", "lambda_iov"]] - two[["t_n", "D_over_r", "lambda_iov"]]).max().max()
print(f"largest difference {difference:.1e}")
sys.exit(not difference < 1e-8)'
try opticcup python3 -c "$compare"

if [ "${1:-}" != --no-tests ]; then
    say "building the test stage, and the quick tests in it"
    build test opticcup-test
    try opticcup-test bash -c 'cd /opt/opticcup/source && exec python3 -m pytest -m "not slow" \
        -p no:cacheprovider -q'
fi
say "passed"
