# shellcheck shell=bash
# The cache folder of docker/run: locks, the steps of a set-up, removal of what is old.

choose_cache() {
    local folder=${OPTICCUP_ENV:-${XDG_CACHE_HOME:-${HOME:+$HOME/.cache}}}
    [ -n "$folder" ] || die "neither HOME nor OPTICCUP_ENV is set, so there is no place for the cache."
    [ -n "${OPTICCUP_ENV:-}" ] || folder=$folder/opticcup_fem
    if ! mkdir -p "$folder/home" 2>/dev/null || [ ! -w "$folder" ]; then
        die "the folder $folder cannot be written; set OPTICCUP_ENV to one that can."
    fi
    cache=$(cd "$folder" && pwd -P)
}

# Removes folders, but never what is mounted in them.
discard() { rm -rf --one-file-system -- "$@"; }

# One set-up at a time.  What an earlier one left unfinished is removed; every finished part has
# been renamed to its own name, which tells that it is whole.
begin_setup() {
    exec {setup_lock}>"$cache/setup.lock"
    if ! flock -n "$setup_lock"; then
        say "another docker/run is making the environment in $cache; waiting for it."
        flock "$setup_lock"
    fi
    discard "$cache"/partial.*
    partial=$(mktemp -d "$cache/partial.XXXXXX")
    log=$cache/setup.log
    : >"$log"
    job=
    trap 'discard "$partial"' EXIT
    trap 'stop_job; exit 130' INT
    trap 'stop_job; exit 143' TERM HUP
}

end_setup() {
    discard "$partial"
    trap - EXIT INT TERM HUP
    exec {setup_lock}>&-
}

# Runs a step of the set-up with its output in the log.  It has a process group of its own, so
# that an interruption ends all of it before its folder is removed.
logged() {
    set -m
    "$@" >>"$log" 2>&1 </dev/null &
    job=$!
    set +m
    local status=0
    wait "$job" || status=$?
    job=
    return "$status"
}

stop_job() {
    [ -z "$job" ] || { kill -TERM -- "-$job"; wait "$job"; } 2>/dev/null || true
}

fail_setup() {
    tail -n 15 "$log" >&2
    die "$* (the last lines of $log are above)."
}

# Every command holds a shared lock on what it uses (the lock passes to it with the open file); the
# time of the lock file is that of the last use.
hold() {
    local lock
    exec {lock}>>"$cache/$1.lock"
    flock -s "$lock"
    touch "$cache/$1.lock"
}

# Of each kind the two that were used last are kept, so that two checkouts with different lists do
# not take turns in removing each other's.
prune() {
    local kind=$1 kept=0 old
    while read -r old; do
        old=${old%.lock}
        [ -d "$old" ] || continue
        kept=$((kept + 1))
        [ "$kept" -gt 2 ] || continue
        flock -n -x "$old.lock" mv "$old" "$partial/old" 2>/dev/null || continue
        discard "$partial/old"
    done < <(find "$cache" -maxdepth 1 -name "$kind-*.lock" -printf '%T@ %p\n' |
        sort -rn | cut -d ' ' -f 2-)
}

# `opticcup` is a script that imports by PYTHONPATH, hence always the checkout that calls.
write_command() {
    printf '#!%s/bin/python3\nimport sys\n\nfrom opticcup_fem.cli import main\n\nif __name__ == "__main__":\n    sys.exit(main())\n' \
        "$2" >"$1/bin/opticcup"
    chmod +x "$1/bin/opticcup"
}
