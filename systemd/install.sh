#!/bin/sh
# Install or upgrade ramstroke on this computer from its wheel:   sudo sh install.sh ramstroke-0.1.0-py3-none-any.whl
# Into an environment of its own, /opt/ramstroke. Recordings, configuration and learned state stay as they are.
set -eu
WHEEL="${1:?name the wheel, such as ramstroke-0.1.0-py3-none-any.whl}"
PREFIX="${PREFIX:-/opt/ramstroke}"
PYTHON="${PYTHON:-python3}"
[ -f "$WHEEL" ] || { echo "install.sh: there is no file $WHEEL" >&2; exit 2; }
[ "$(id -u)" -eq 0 ] || { echo "install.sh: needs root: sudo sh install.sh $WHEEL" >&2; exit 2; }
[ -x "$PREFIX/bin/python" ] || "$PYTHON" -m venv "$PREFIX"
"$PREFIX/bin/python" -m pip install --quiet --disable-pip-version-check --upgrade "$WHEEL[hardware]"
exec "$PREFIX/bin/ramstroke" install-service
