# SPDX-License-Identifier: Apache-2.0
"""The statements of people as a table and as a map, for the record of clearance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from csv import DictWriter
from datetime import datetime, timezone
import io
from itertools import groupby
import json
from typing import Any

from kbnitp_ros.base.said import contradictions, Statement
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.files import counted
from kbnitp_ros.maps import Datum
from kbnitp_ros.messages.headers import in_seconds, SECOND
from kbnitp_ros.report.mission import MissionSummary
import numpy as np

# Columns of said.csv, and properties of the features of said.geojson.
COLUMNS = (
    'time', 'author', 'kind', 'agent', 'deployment', 'says', 'hazard', 'target', 'confidence',
    'walked', 'changed', 'since', 'steps', 'by_hazard', 'cells', 'note', 'hash', 'revokes',
    'holds', 'revoked_by', 'revoked_at', 'frame', 'polygon',
)  # fmt: skip

# Corners of a cell in sides of cells, counterclockwise, as GeoJSON has them.
Ring = list[list[float]]

METRES, EARTH = 'map, metres: x y', 'WGS84, degrees: longitude latitude'


def said_csv(mission: MissionSummary) -> str:
    """Return all statements as a table, one row each."""
    text = io.StringIO()
    table = DictWriter(text, COLUMNS, lineterminator='\n')
    table.writeheader()
    for said in mission.said:
        rings = outlines(mission.grid, said.cells, mission.datum)
        table.writerow({**properties(mission, said), 'polygon': wkt(rings)})
    return text.getvalue()


def said_geojson(mission: MissionSummary) -> str:
    """Return all statements as a collection of features, one each."""
    features = [
        {
            'type': 'Feature',
            'geometry': {
                'type': 'MultiPolygon',
                'coordinates': [
                    [ring] for ring in outlines(mission.grid, said.cells, mission.datum)
                ],
            }
            if said.cells
            else None,
            'properties': properties(mission, said),
        }
        for said in mission.said
    ]
    return json.dumps({'type': 'FeatureCollection', 'features': features}, allow_nan=False)


def properties(mission: MissionSummary, said: Statement) -> dict[str, Any]:
    """Return the values of a statement by the names of `COLUMNS`, without its polygon."""
    values = {name: each for name, each in said.values.items() if name in COLUMNS}
    for name in values.keys() & {'deployment', 'since'}:
        values[name] = in_seconds(values[name] or 0)
    if 'steps' in values:
        values['steps'] = in_text(values['steps'])
    if 'revokes' in values:
        values['revokes'] = str(values['revokes'])
    by = said.revoked_by
    return {
        'time': in_utc(said.stamp),
        'author': said.author,
        'kind': said.kind,
        **values,
        'cells': in_text(said.cells),
        'note': said.note,
        'hash': str(said.content) if said.content else None,
        'holds': said.holds,
        'revoked_by': by.author if by else None,
        'revoked_at': in_utc(by.stamp) if by else None,
        'frame': EARTH if mission.datum else METRES,
    }


# What the page marks on its map, by the kind of a statement, and of what is said of a robot.
MARKS = {'finding': 'finding', 'LOCATED': 'wreck', 'no_go': 'closed'}


def said_rows(mission: MissionSummary) -> list[dict[str, Any]]:
    """Return the statements as rows of the page, with the cells that it marks."""
    numbers = {each.key: number for number, each in enumerate(mission.deployments, 1)}
    words = {each.content: each.words for each in mission.said}
    rows = []
    for said in mission.said:
        key = DeploymentKey(said.values.get('agent', ''), said.values.get('deployment', 0))
        taken_back = words.get(said.values['revokes'], '') if said.kind == 'revocation' else ''
        rows.append(
            {
                'time': in_utc(said.stamp)[11:19],
                'author': said.author,
                'words': f'takes back: {taken_back}' if taken_back else said.words,
                'number': numbers.get(key),
                'cells': list(said.cells),
                'count': len(said.cells),
                'holds': holds_in_words(said),
                'note': said.note,
                'mark': MARKS.get(said.values.get('says', said.kind)) if said.holds else None,
                **({'cell': said.cells[0]} if said.cells else {}),
            }
        )
    return rows


def holds_in_words(said: Statement) -> str:
    """Return whether a statement holds, and who took it back."""
    if said.revoked_by:
        return f'taken back by {said.revoked_by.author or "a person"}'
    return 'yes' if said.holds else 'no'


def contradiction_notes(mission: MissionSummary) -> Iterator[str]:
    """Yield a note on each two findings that contradict each other."""
    by_content = {each.content: each for each in mission.said}
    for pair, cells in contradictions(mission.said).items():
        said = ' and '.join(
            f'{by_content[each].author or "a person"} ({in_utc(by_content[each].stamp)[11:19]}: '
            f'{by_content[each].words})'
            for each in pair
        )
        size = counted(len(cells), 'cell')
        yield f'Two findings contradict each other in {size}: {said}. Both count.'


def in_utc(stamp: int) -> str:
    """Return a time in ISO 8601, to the millisecond."""
    at = datetime.fromtimestamp(stamp / SECOND, timezone.utc)
    return at.isoformat(timespec='milliseconds').replace('+00:00', 'Z')


def in_text(numbers: Sequence[int]) -> str:
    """Return numbers separated by blanks."""
    return ' '.join(map(str, numbers))


def outlines(grid: Grid, cells: Sequence[int], datum: Datum | None) -> list[Ring]:
    """Return rings around the cells: in metres, or in degrees if there is a datum."""
    corners = [
        [(first, row), (last + 1, row), (last + 1, row + 1), (first, row + 1), (first, row)]
        for row, first, last in runs(grid, cells)
    ]
    if not corners:
        return []
    places = grid.in_metres(np.array(corners, dtype=float))
    if datum:
        flat = datum.on_earth(places.reshape(-1, 2))
        places = flat[:, ::-1].reshape(places.shape)
    rings: list[Ring] = places.tolist()
    return rings


def runs(grid: Grid, cells: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """Yield the row, first and last column of cells that lie side by side."""
    numbered = enumerate(sorted({*cells}))
    # Rows end where the number of a cell and its row no longer grow alike.
    for _, run in groupby(numbered, lambda each: (each[1] - each[0], each[1] // grid.width)):
        row_cells = [cell for _, cell in run]
        row, first = divmod(row_cells[0], grid.width)
        yield row, first, row_cells[-1] % grid.width


def wkt(rings: Sequence[Ring]) -> str:
    """Return rings as the text that geographic programs read; empty without rings."""
    parts = (', '.join(f'{x!r} {y!r}' for x, y in ring) for ring in rings)
    texts = ', '.join(f'(({each}))' for each in parts)
    return f'MULTIPOLYGON ({texts})' if texts else ''
