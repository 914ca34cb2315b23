#!/bin/sh
# Sets up what compare.py needs: a Python environment with the peers that come from PyPI. What only the system's package manager
# has is named, and installed when --system is given.
#
#   scripts/peers/install.sh VENV             environment in the folder VENV; says what is missing
#   scripts/peers/install.sh --system VENV    installs Debian packages as well (as root)
set -eu

packages="plastimatch libgl1-mesa-dri libegl1 libgl1 libosmesa6 python3-venv"
system=no
if [ "${1:-}" = --system ]; then
    system=yes
    shift
fi
if [ $# -ne 1 ] || [ "${1#-}" != "$1" ]; then
    sed -n '2,6s/^# \{0,1\}//p' "$0" >&2
    exit 2
fi
venv=$1

if [ "$system" = yes ]; then
    apt-get install --no-install-recommends -y $packages
fi
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet --requirement "$(dirname "$0")/requirements.txt"

missing=""
command -v plastimatch >/dev/null || missing="plastimatch (leaves plastimatch out)"
if ! "$venv/bin/python" -c 'import vtk; w = vtk.vtkRenderWindow(); w.SetOffScreenRendering(1); w.Render()' >/dev/null 2>&1; then
    missing="$missing${missing:+; }a software OpenGL (leaves VTK out)"
fi
if [ -n "$missing" ]; then
    echo "missing: $missing" >&2
    echo "on Debian: apt-get install $packages, or this script with --system as root" >&2
fi
echo "$venv/bin/python $(dirname "$0")/compare.py --help"
