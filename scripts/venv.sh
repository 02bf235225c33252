#!/bin/sh
# Makes a virtual environment; where Python lacks venv it is installed as root, else the one line to run is said.
set -eu
venv=$1
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(not ((3, 11) <= sys.version_info[:2] <= (3, 13)))' || {
  echo "fleetpose needs Python 3.11 to 3.13, '$python' is $("$python" -V 2>&1): make PYTHON=python3.12 ..." >&2
  exit 2
}
if ! "$python" -m venv "$venv" >/dev/null 2>&1; then
  rm -rf "$venv"
  version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  install="apt-get update && apt-get install -y python$version-venv"
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    sh -c "$install" >/dev/null
    "$python" -m venv "$venv"
  else
    echo "Python's venv module is missing. Run: sudo sh -c '$install'" >&2
    exit 2
  fi
fi
