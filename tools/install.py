# SPDX-License-Identifier: Apache-2.0
"""
Install a lock file into .venv with uv, from where pip is configured to install from.

usage: .venv/bin/python tools/install.py LOCK [OPTIONS OF uv pip install]
"""

from ast import literal_eval
import os
from pathlib import Path
import re
import subprocess
import sys

UV = Path(__file__).parents[1] / '.tools/bin/uv'

# Options of pip, and of uv.
OPTIONS = {
    'index-url': '--default-index',
    'extra-index-url': '--index',
    'find-links': '--find-links',
    'trusted-host': '--allow-insecure-host',
}
VARIABLES = {
    'cert': 'SSL_CERT_FILE',
    'client-cert': 'SSL_CLIENT_CERT',
    'proxy': 'ALL_PROXY',
    'timeout': 'UV_HTTP_TIMEOUT',
    'default-timeout': 'UV_HTTP_TIMEOUT',
}

ENTRY = re.compile(r'#.*|[\w.\[\]-]+==[\w.]+(?: ; .+)? \\|    --hash=sha256:[0-9a-f]{64}(?: \\)?')


def configuration() -> dict[str, str]:
    """Return the options of `pip install` that files and variables set."""
    listed = subprocess.check_output([sys.executable, '-m', 'pip', 'config', 'list'], text=True)
    sections: dict[str, dict[str, str]] = {'global': {}, 'install': {}, ':env:': {}}
    for line in listed.splitlines():
        name, _, value = line.partition('=')
        section, _, option = name.partition('.')
        sections.setdefault(section, {})[option] = literal_eval(value)
    return {**sections['global'], **sections['install'], **sections[':env:']}


def main(lock: str, *more: str) -> int:
    """Install, and name the lines of the lock file that do not fit."""
    lines = [*enumerate(Path(lock).read_text().splitlines(), 1)]
    wrong = [each for each in lines if not ENTRY.fullmatch(each[1])]
    if not wrong:
        given = configuration()
        options = [
            word
            for name in OPTIONS.keys() & given.keys()
            for value in given[name].split()
            for word in (OPTIONS[name], value)
        ]
        if given.get('no-index', '') in ('1', 'on', 'true', 'yes'):
            options.append('--no-index')
        variables = dict(os.environ)
        # pip takes certificates from there as well.
        for name in os.environ.keys() & {'REQUESTS_CA_BUNDLE', 'CURL_CA_BUNDLE'}:
            variables.setdefault('SSL_CERT_FILE', os.environ[name])
        variables |= {VARIABLES[name]: given[name] for name in VARIABLES.keys() & given.keys()}
        uv = [UV, 'pip', 'install', '--python', sys.executable, '--require-hashes', *more]
        # As pip does: any index may have the file.
        uv += ['--index-strategy', 'unsafe-best-match', *options, '--requirement', lock]
        said = ''
        pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT}
        with subprocess.Popen(uv, env=variables, text=True, **pipes) as process:
            for line in process.stdout or ():
                print(line, end='', flush=True)
                said += line
        if not process.returncode:
            return 0
        wrong = [(n, line) for n, line in lines if '==' in line and line.split()[0] in said]
    for number, line in wrong:
        print(f'{lock}, line {number}: {line.strip()}')
    return 1


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
