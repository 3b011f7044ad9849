#!/bin/sh
# Install ramstroke on this computer from its wheel, or bring it to the wheel's version, newer or older:
#     sudo sh install.sh [--offline] [--with EXTRA,...] ramstroke-0.1.0-py3-none-any.whl
# --offline: the packages that it needs lie in the wheel's folder, and no network is asked.
# --with: what else it shall be able to do, such as view, the live page.
# Into an environment of its own, /opt/ramstroke. Recordings, configuration and learned state stay as they are.
set -eu
umask 022 # the service's user must be able to read what root writes
PREFIX="${PREFIX:-/opt/ramstroke}"
PYTHON="${PYTHON:-python3}"

refuse() {
    echo "install.sh: $1" >&2
    exit 2
}

OFFLINE=
EXTRAS=hardware
while :; do
    case "${1:-}" in
        --offline)
            OFFLINE=yes
            shift
            ;;
        --with)
            known=view,foxglove,offline,parquet,tuning
            case "${2:-}" in
                '' | ,* | *, | *,,* | *[!a-z,]*) refuse "--with needs names, separated by commas, of $known" ;;
            esac
            for extra in $(echo "$2" | tr , ' '); do
                case ",$known," in
                    *",$extra,"*) ;;
                    *) refuse "--with $extra is unknown; there are $known" ;;
                esac
            done
            EXTRAS="$EXTRAS,$2"
            shift 2
            ;;
        -*) refuse "$1 is unknown; there are --offline and --with EXTRA,..." ;;
        *) break ;;
    esac
done
WHEEL="${1:-}"
[ $# -eq 1 ] || refuse "name one wheel, such as ramstroke-0.1.0-py3-none-any.whl, after the options --offline and --with"
[ -f "$WHEEL" ] || refuse "there is no file $WHEEL"
case "${WHEEL##*/}" in
    ramstroke-*-*.whl) ;;
    *) refuse "$WHEEL is not a wheel of ramstroke, whose name begins with ramstroke- and ends with .whl" ;;
esac
[ "$(id -u)" -eq 0 ] || refuse "needs root: sudo sh install.sh $WHEEL"
command -v "$PYTHON" >/dev/null || refuse "there is no $PYTHON here: sudo apt install python3 python3-venv"
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    refuse "$("$PYTHON" --version) is too old, 3.11 is needed: name a newer one, sudo PYTHON=python3.11 sh install.sh ..."

ours() { "$PREFIX/bin/python" -I "$@"; }
version() { ours -c 'from importlib.metadata import version; print(version("ramstroke"))' 2>/dev/null || true; }
pip_install() {
    if ! said=$(ours -m pip install --quiet --no-cache-dir --disable-pip-version-check ${OFFLINE:+--no-index --find-links "$FOLDER"} \
        "$@" 2>&1); then
        reason=$(printf '%s\n' "$said" | sed -n 's/^ERROR: //p' | tail -n 1)
        refuse "$WHEEL is not installed, nothing was changed: ${reason:-$said}"
    fi
}

FOLDER=$(dirname "$WHEEL")
# An environment without a working pip is half made, or of a Python that is gone.
if ! ours -m pip --version >/dev/null 2>&1; then
    "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
        refuse "$PYTHON cannot make environments: sudo apt install python3-venv"
    if [ -e "$PREFIX" ] && [ ! -e "$PREFIX/pyvenv.cfg" ]; then
        refuse "$PREFIX is there and no environment of Python: move it away, or name another place with PREFIX="
    fi
    # What is not finished goes away again, also when it is interrupted.
    trap 'rm -rf "$PREFIX"' EXIT
    trap 'exit 130' INT TERM HUP
    "$PYTHON" -m venv --clear "$PREFIX" || refuse "$PYTHON -m venv $PREFIX failed, nothing was installed"
fi
echo "installing ${WHEEL##*/} into $PREFIX"
before=$(version)
pip_install --upgrade "$WHEEL[$EXTRAS]"
# pip leaves a wheel of the same version alone, even if another one was built.
[ "$before" != "$(version)" ] || pip_install --no-deps --force-reinstall "$WHEEL"
trap - EXIT INT TERM HUP
exec "$PREFIX/bin/ramstroke" install-service
