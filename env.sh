# The environment that `make build` made, for bash:  . ./env.sh

root="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"

. "$root/.venv/bin/activate"
export AMENT_PREFIX_PATH="$VIRTUAL_ENV"
if [ -f "$root/install/local_setup.bash" ]; then
  . "$root/install/local_setup.bash"
fi
unset root
