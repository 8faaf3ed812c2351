#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Execute the notebooks of docs/notebooks and write them with what came out.

``python3 tools/notebooks.py`` writes them where they are, ``python3 tools/notebooks.py FOLDER`` to
another folder. What changes from run to run is left out: times, the version of Python and what is
said on standard error, such as that kernels are being compiled.
"""

from pathlib import Path
import sys

from nbclient import NotebookClient
import nbformat

NOTEBOOKS = Path(__file__).parents[1] / 'docs/notebooks'


def execute(folder: Path) -> None:
    """Execute all notebooks, and write them to a folder."""
    for path in sorted(NOTEBOOKS.glob('*.ipynb')):
        notebook = nbformat.read(path, as_version=4)
        metadata = {**notebook.metadata}
        client = NotebookClient(
            notebook,
            timeout=600,
            record_timing=False,
            resources={'metadata': {'path': str(NOTEBOOKS)}},
        )
        client.execute()
        notebook.metadata = metadata
        for cell in notebook.cells:
            if cell.cell_type == 'code':
                cell.outputs = [each for each in cell.outputs if each.get('name') != 'stderr']
        nbformat.write(notebook, folder / path.name)
        print(f'executed {path.name}')


if __name__ == '__main__':
    execute(Path(sys.argv[1]) if len(sys.argv) > 1 else NOTEBOOKS)
