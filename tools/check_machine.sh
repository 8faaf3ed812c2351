#!/bin/sh
# Say what `make` misses on this machine, one line each, with the remedy.
# usage: check_machine.sh PYTHON MEGABYTES

LC_ALL=C
python=$1
need=$2
status=0

missing() {
  echo "$1" >&2
  status=1
}

if [ "$(uname -sm)" != 'Linux x86_64' ]; then
  missing "This is $(uname -sm), and the ROS 2 wheels are for Linux x86_64: install ROS 2 Jazzy and use 'colcon build'."
fi

here=$(pwd -P)
case $here in
  *[!A-Za-z0-9/._+@-]*)
    missing "Messages cannot be built in the folder '$here': rosidl takes only letters of ASCII, digits and /._+@- in a path. Move this folder."
    ;;
esac

free=$(df -Pk . | { read -r _ && read -r _ _ _ free _ && echo $((free / 1024)); })
if [ "${free:-$need}" -lt "$need" ]; then
  missing "The disk of $here has $free MB free, and $need MB are needed: free some space, or move this folder."
fi

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
case $version in
  3.10 | 3.11 | 3.12 | 3.13)
    if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
      missing "$python has no venv module: apt install python$version-venv"
    fi
    header=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
    if ! [ -f "$header" ]; then
      missing "$python has no header files ($header): apt install python$version-dev"
    fi
    ;;
  '')
    missing "There is no $python: apt install python3, or name a Python 3.10 to 3.13: make PYTHON=python3.12"
    ;;
  *)
    missing "$python is Python $version, and the ROS 2 wheels are for 3.10 to 3.13: name one: make PYTHON=python3.12"
    ;;
esac

if ! command -v ${CC:-cc} >/dev/null; then
  missing 'There is no C compiler: apt install g++'
elif ! command -v ${CXX:-c++} >/dev/null; then
  missing 'There is no C++ compiler: apt install g++'
fi

exit $status
