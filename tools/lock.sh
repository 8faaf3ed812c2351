#!/bin/bash
# Write requirements/*.lock anew from requirements/*.txt: all packages that pip would install for CPython
# 3.10 to 3.13 on Linux x86-64, with the hashes of their files. It takes uv (0.13 was used) and the network.

set -eo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../requirements"
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
cp ./*.txt "$work"
cat > "$work/pyproject.toml" << 'END'
[project]
name = "lock"
version = "0"
requires-python = ">=3.10,<3.14"
[tool.uv]
environments = ["python_full_version < '3.14' and platform_machine == 'x86_64' and platform_python_implementation == 'CPython' and sys_platform == 'linux'"]
END

compile() {
  (cd "$work" && uv pip compile --quiet --universal --python-version 3.10 --no-header --no-annotate "$@")
}

# One version of each package in all files, since they share an environment.
compile ./*.txt --output-file all.pins
for file in *.txt; do
  # With extras: to a package that another one wants with an extra, pip applies no pin without it.
  compile "$file" --no-strip-extras --constraints all.pins --generate-hashes --output-file lock
  # What is said of every package is left out.
  {
    echo "# Written by tools/lock.sh from $file: all packages, with the hashes of their files."
    sed -e "s/ and platform_machine == 'x86_64' and platform_python_implementation == 'CPython' and sys_platform == 'linux'//" \
      -e "s/ and python_full_version < '3.14'//" -e "s/ ; python_full_version < '3.14' and / ; /" \
      -e "s/ ; python_full_version < '3.14' / /" "$work/lock"
  } > "${file%.txt}.lock"
done
