#!/bin/bash
# Run a command that takes long: say what it does, every few seconds how far it is, and all about
# it if it fails.
# usage: step.sh WHAT COMMAND [ARGUMENTS]

period=${STEP_PERIOD:-5}
width=${COLUMNS:-99}

what=$1
shift
said=$(mktemp)

# The newest line of what the command says; behind a carriage return it starts anew.
follow() {
  while sleep "$period"; do
    # It may be gone: the command has ended.
    line=$(tail -c 1000 "$said" 2>/dev/null | tr '\r' '\n' | grep -v '^[[:space:]]*$' | tail -n 1)
    line="$what, $SECONDS s: $line"
    echo "  ${line:0:$((width - 2))}"
  done
}

echo "$what ..."
follow &
follower=$!
trap interrupted=yes INT
trap 'kill $follower 2>/dev/null; rm -f "$said"' EXIT
# In the foreground, where Ctrl-C reaches it.
"$@" >"$said" 2>&1
status=$?
kill $follower 2>/dev/null
wait $follower 2>/dev/null

if [ $status = 0 ]; then
  echo "$what: done in $SECONDS s"
elif [ "$interrupted" ]; then
  echo "$what: interrupted; the next make continues" >&2
else
  {
    cat "$said"
    echo "$what failed with exit code $status: $*"
    if grep -qi certificate "$said"; then
      echo 'A proxy with a certificate of its own is known to pip by PIP_CERT=FILE in the environment,' \
        'to npm by NODE_EXTRA_CA_CERTS=FILE.'
    fi
  } >&2
fi
exit $status
