#!/bin/sh
# The package as it is installed, for tools that look at files instead of importing:
# links.sh DIR makes DIR/fleetpose of links to the folders; links.sh -c DIR of copies.
set -eu
make="ln -sfn"
if [ "$1" = -c ]; then
  shift
  make="cp -r"
  rm -rf "$1"
fi
mkdir -p "$1/fleetpose"
for name in formats protocol rosmsg robot_agent pose_server hmi_client evaluation deploy ros_bridge; do
  $make "$(pwd)/$name" "$1/fleetpose/$name"
done
for name in __init__.py py.typed; do
  $make "$(pwd)/api/$name" "$1/fleetpose/$name"
done
