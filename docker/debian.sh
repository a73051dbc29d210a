# shellcheck shell=bash
# docker/run elsewhere: a Debian root filesystem, made with mmdebstrap, entered with bubblewrap.
# shellcheck disable=SC2154  # project, recipe, cache and partial are set by its other files

readonly suite=${OPTICCUP_SUITE:-trixie}
# Debian 13's parts are named as ever; those of another suite say of which.
case $suite in trixie) readonly flavour= ;; *) readonly flavour=$suite- ;; esac
readonly venv_inside=/opticcup-venv # the same path for every venv, so that one can be renamed
readonly free_gigabytes=6

debian_packages() {
    sed 's/#.*//' "$project/docker/packages.txt" | tr -s ' \t' '\n' | grep . | sort -u
}

# What it takes to build a root filesystem, or to run in one.
install_tools() {
    local missing=() become=()
    command -v bwrap >/dev/null || missing+=(bubblewrap)
    if [ "$1" = build ]; then
        command -v mmdebstrap >/dev/null || missing+=(mmdebstrap)
        compgen -G '/usr/share/keyrings/debian-archive-keyring.*' >/dev/null ||
            missing+=(debian-archive-keyring)
        [ "$EUID" = 0 ] || command -v newuidmap >/dev/null || missing+=(uidmap)
    fi
    [ ${#missing[@]} -gt 0 ] || return 0
    command -v apt-get >/dev/null ||
        die "missing here, with no apt-get to install them: ${missing[*]}; install them, or use" \
            "docker/Dockerfile."
    if [ "$EUID" != 0 ]; then
        become=(sudo -n)
        sudo -n true 2>/dev/null ||
            die "missing here: ${missing[*]}; have root run \`apt-get install ${missing[*]}\`, or use" \
                "docker/Dockerfile."
    fi
    say "installing ${missing[*]} with apt-get."
    "${become[@]}" sh -c 'export DEBIAN_FRONTEND=noninteractive
        apt-get -qq install -y --no-install-recommends "$@" ||
        { apt-get -qq update && apt-get -qq install -y --no-install-recommends "$@"; }' \
        sh "${missing[@]}" >"$cache/setup.log" 2>&1 </dev/null ||
        die "apt-get could not install ${missing[*]} (see $cache/setup.log)."
}

check_machine() {
    bwrap --ro-bind / / true 2>/dev/null ||
        die "bubblewrap may not make namespaces on this machine ($(bwrap --ro-bind / / true 2>&1 |
            head -n 1)); have that allowed, or use docker/Dockerfile."
    local free
    free=$(df -Pk "$cache" | awk 'NR == 2 { print int($4 / 1048576) }')
    [ "$free" -ge "$free_gigabytes" ] ||
        die "the environment needs $free_gigabytes GB while it is made and $cache has $free GB free;" \
            "set OPTICCUP_ENV to a folder with more room."
}

# The mirror is mmdebstrap's own choice if it is empty.
mmdebstrap_steps() {
    local mirror=$1
    local options=(
        --variant=apt "--include=$(debian_packages | paste -sd ,)"
        --dpkgopt=path-exclude='/usr/share/doc/*' --dpkgopt=path-include='/usr/share/doc/*/copyright'
        --dpkgopt=path-exclude='/usr/share/man/*' --dpkgopt=path-exclude='/usr/share/locale/*'
        --dpkgopt=path-exclude='/usr/share/info/*'
    )
    # The lists of a suite in motion are valid for a week only, and a mirror may lag.
    [ "$suite" = trixie ] || options+=('--aptopt=Acquire::Check-Valid-Until "false"')
    discard "$partial/rootfs"
    mkdir "$partial/rootfs"
    if [ "$EUID" = 0 ]; then
        # In namespaces of its own, with which its mounts and processes end, however it or its
        # caller ends.
        exec setpriv --pdeathsig KILL unshare --mount --pid --fork --kill-child \
            mmdebstrap --mode=root "${options[@]}" "$suite" "$partial/rootfs" ${mirror:+"$mirror"}
    else
        # By way of tar, for the files would belong to users that only newuidmap knows.
        mmdebstrap --mode=unshare "${options[@]}" "$suite" - ${mirror:+"$mirror"} |
            tar -x -C "$partial/rootfs" --no-same-owner --exclude='./dev/*'
    fi
}

# The Debian mirror of this machine, if it is a Debian.
host_mirror() {
    # shellcheck disable=SC2016  # apt-get, not the shell, fills in the address
    apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Origin: Debian' 2>/dev/null |
        grep -v security | head -n 1 || true
}

make_rootfs() {
    say "making a Debian root filesystem ($suite) in $rootfs, once: 2 to 5 minutes, 3.3 GB."
    logged mmdebstrap_steps "${OPTICCUP_MIRROR:-}" ||
        { [ -z "${OPTICCUP_MIRROR:-}" ] && logged mmdebstrap_steps "$(host_mirror)"; } ||
        fail_setup "mmdebstrap could not make the root filesystem"
    # Places to bind the host's files of these names on.
    touch "$partial"/rootfs/etc/{hosts,resolv.conf}
    mv -T "$partial/rootfs" "$rootfs"
}

make_venv() {
    say "installing the pinned Python packages of docker/requirements*.txt."
    mkdir "$partial/venv"
    if ! logged enter --bind "$partial/venv" python3 -m venv --system-site-packages "$venv_inside" ||
        ! logged enter --bind "$partial/venv" \
            python3 -m pip install -r "$project/docker/requirements.txt" \
            -r "$project/docker/requirements-docs.txt"; then
        fail_setup "pip could not install what docker/requirements*.txt list"
    fi
    write_command "$partial/venv" "$venv_inside"
    logged enter --ro-bind "$partial/venv" \
        python3 -c 'import dolfinx, gmsh, ipctk, petsc4py, pyvista, slepc4py' ||
        fail_setup "the new environment cannot import its own packages"
    mv -T "$partial/venv" "$venv"
}

make_environment() {
    if [ ! -d "$rootfs" ]; then
        install_tools build
        check_machine
    fi
    begin_setup
    [ -d "$rootfs" ] || make_rootfs
    [ -d "$venv" ] || make_venv
    prune "${flavour}rootfs"
    prune "${flavour}venv"
    end_setup
}

# The host's certificates, for pip and git behind a proxy that signs by itself.
certificates() {
    local bundle
    for bundle in "${PIP_CERT:-}" "${SSL_CERT_FILE:-}" "${REQUESTS_CA_BUNDLE:-}" \
        /etc/ssl/certs/ca-certificates.crt /etc/pki/tls/certs/ca-bundle.crt /etc/ssl/cert.pem; do
        [ ! -f "$bundle" ] || { printf '%s' "$bundle"; return; }
    done
}

bind_files() {
    local folder file bundle
    # The root is an empty file system, on which any mount point can be made; it is read-only at
    # the end, so that nothing is written to a place that vanishes with it.
    binds=(
        --ro-bind "$rootfs/usr" /usr --ro-bind "$rootfs/etc" /etc
        --symlink usr/bin /bin --symlink usr/sbin /sbin --symlink usr/lib /lib
        --symlink usr/lib64 /lib64 --dev /dev --proc /proc --ro-bind /sys /sys
        --tmpfs /run --dir /var/lib --tmpfs /var/tmp --symlink /run /var/run
        --ro-bind "$rootfs/var/lib/dpkg" /var/lib/dpkg --tmpfs /var/lib/xkb
    )
    for file in /etc/resolv.conf /etc/hosts /etc/passwd /etc/group; do
        [ ! -f "$file" ] || binds+=(--ro-bind "$file" "$file")
    done
    # The user's own folders, wherever they are.
    for folder in /*/; do
        folder=${folder%/}
        case $folder in
            /bin | /boot | /dev | /etc | /lib* | /lost+found | /proc | /run | /sbin | /sys | /usr | /var) ;;
            *) [ -L "$folder" ] || binds+=(--bind "$folder" "$folder") ;;
        esac
    done
    for folder in "$project" "$PWD" "$cache"; do
        case $folder in
            /usr/* | /etc/*) die "$folder is in a system folder, which the environment has its own of." ;;
            /) ;;
            *) binds+=(--bind "$folder" "$folder") ;;
        esac
    done
    # With process numbers of its own, all that the command started ends with it (the ranks of a
    # killed mpirun would live on); not every container allows it.
    if bwrap --ro-bind / / --unshare-pid --proc /proc true 2>/dev/null; then
        binds+=(--unshare-pid)
    fi
    # Open MPI names its folders by these numbers: they must not meet those of another run.
    binds+=(--tmpfs "/tmp/ompi.${HOSTNAME%%.*}.$EUID")
    bundle=$(certificates)
    if [ -n "$bundle" ]; then
        binds+=(--ro-bind "$bundle" /certificates.pem --setenv PIP_CERT /certificates.pem
            --setenv SSL_CERT_FILE /certificates.pem)
    fi
}

set_variables() {
    local name
    # shellcheck disable=SC2054  # the comma is Open MPI's
    variables=(
        --setenv OPTICCUP_INSIDE 1
        --setenv PATH "$venv_inside/bin:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
        --setenv HOME "$cache/${flavour}home" --setenv USER "${USER:-$(id -un)}" --setenv LANG C.UTF-8
        --setenv PYTHONPATH "$project" --setenv OMP_NUM_THREADS "${OMP_NUM_THREADS:-1}"
        --setenv MPLBACKEND Agg --setenv PYVISTA_OFF_SCREEN true
        # Open MPI: root may, shared memory is the only network, more processes than cores are
        # fine, two jobs at once are not pinned to the same core, and its folders are private.
        --setenv OMPI_ALLOW_RUN_AS_ROOT 1 --setenv OMPI_ALLOW_RUN_AS_ROOT_CONFIRM 1
        --setenv OMPI_MCA_pml ob1 --setenv OMPI_MCA_btl self,sm
        --setenv PRTE_MCA_rmaps_default_mapping_policy :oversubscribe
        --setenv PRTE_MCA_hwloc_default_binding_policy none --setenv PRTE_MCA_prte_tmpdir_base /run
    )
    for name in $(compgen -e); do
        case $name in
            OPTICCUP_INSIDE) ;;
            OPTICCUP_* | PETSC_OPTIONS | SLEPC_OPTIONS | OMPI_MCA_* | PRTE_MCA_* | \
                TERM | COLORTERM | COLUMNS | LINES | NO_COLOR | FORCE_COLOR | CI | TZ | \
                http_proxy | https_proxy | no_proxy | HTTP_PROXY | HTTPS_PROXY | NO_PROXY | \
                PIP_PROXY | PIP_DEFAULT_TIMEOUT | PIP_TRUSTED_HOST | PYTEST_ADDOPTS | SOURCE_DATE_EPOCH)
                variables+=(--setenv "$name" "${!name}") ;;
            PIP_INDEX_URL)
                case ${!name} in http*) variables+=(--setenv "$name" "${!name}") ;; esac ;;
        esac
    done
}

# enter HOW VENV CMD...: HOW is --ro-bind, or --bind while the venv is made.
enter() {
    local how=$1 folder=$2 binds variables
    shift 2
    bind_files
    set_variables
    # An interrupt from the keyboard is for the command, not for bwrap, which would end it at once.
    trap '' INT
    exec bwrap --die-with-parent --clearenv "${binds[@]}" "$how" "$folder" "$venv_inside" \
        --remount-ro / --chdir "$PWD" "${variables[@]}" env --default-signal=INT "$@"
}

run_in_debian() {
    local name
    case $suite in
        trixie | sid) ;;
        *) die "OPTICCUP_SUITE is \"$suite\", and must be trixie (Debian 13) or sid." ;;
    esac
    mkdir -p "$cache/${flavour}home"
    name=$(debian_packages | cat - <(echo "$recipe $suite") | fingerprint)
    rootfs=$cache/${flavour}rootfs-$name
    venv=$cache/${flavour}venv-$(cat - "$project"/docker/requirements*.txt <<<"$name" | fingerprint)
    hold "${rootfs##*/}"
    hold "${venv##*/}"
    if [ ! -d "$rootfs" ] || [ ! -d "$venv" ]; then
        make_environment
    fi
    install_tools run
    enter --ro-bind "$venv" "$@"
}
