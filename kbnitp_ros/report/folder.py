# SPDX-License-Identifier: Apache-2.0
"""The files of a report, written together or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import shutil
import tempfile

from kbnitp_ros.report.mission import MissionSummary
from kbnitp_ros.report.page import mission_page
from kbnitp_ros.report.said import said_csv, said_geojson
from kbnitp_ros.report.tables import Curves, write_beliefs, write_tables


def check_is_free(folder: Path) -> None:
    """Check that a report can be written to a folder."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise FileExistsError(f'{folder} exists and is no folder: name another with --out')
    if folder.is_dir() and any(folder.iterdir()):
        raise FileExistsError(f'{folder} exists and is not empty: name another with --out')
    above = next(each for each in folder.absolute().parents if each.exists())
    if not above.is_dir():
        raise NotADirectoryError(
            f'{folder} cannot be made: {above} is no folder; name another with --out'
        )


def write_report(folder: Path, mission: MissionSummary, curves: Curves) -> str:
    """Write a report, all of its files or none; return a note on moments that the page omits."""
    check_is_free(folder)
    with whole_folder(folder) as new:
        page, left_out = mission_page(mission, curves)
        new.joinpath('report.html').write_text(page, encoding='utf-8')
        write_tables(new, mission, curves)
        new.joinpath('said.csv').write_text(said_csv(mission), encoding='utf-8')
        new.joinpath('said.geojson').write_text(said_geojson(mission), encoding='utf-8')
        write_beliefs(new, mission, curves)
    return left_out


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder and move it to its place at the end; remove it on errors."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        new = Path(tempfile.mkdtemp(prefix=f'.{folder.name}.', dir=folder.parent))
    except OSError as error:
        error.filename = str(folder)
        raise
    try:
        yield new
        # A temporary folder is readable by its owner only: give it the usual permissions.
        mask = os.umask(0)
        os.umask(mask)
        new.chmod(0o777 & ~mask)
        new.rename(folder)
    except BaseException as error:
        shutil.rmtree(new, ignore_errors=True)
        # The error may name a file in the temporary folder, which users do not know.
        if isinstance(error, OSError) and str(error.filename or new).startswith(str(new)):
            error.filename = str(folder)
        raise
