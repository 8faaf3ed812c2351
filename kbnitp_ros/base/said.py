# SPDX-License-Identifier: Apache-2.0
"""The statements of people: findings, annotations, revocations and no-go areas."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from kbnitp_ros.base.state import BaseState
from kbnitp_ros.core import Annotation, DeploymentKey, Finding
from kbnitp_ros.core.inference.record import OPEN
from kbnitp_ros.messages.operator_actions import Action, OF_CELLS, OperatorAction
from kbnitp_ros.messages.remarks import Remark


@dataclass(frozen=True)
class Statement:
    """A statement of a person, as stated, and whether it still holds."""

    # 'finding', 'annotation', 'revocation', 'no_go' or 'lift'.
    kind: str
    # Time at which it was said, nanoseconds of ROS time.
    stamp: int
    author: str
    note: str
    # Hash of the message; 0 of a no-go area, which has none.
    content: int
    # Cells that it speaks of; of an annotation, those of its steps.
    cells: tuple[int, ...]
    # What is said in words, without cells and times.
    words: str
    # Its own values, by the names of the fields of its message.
    values: Mapping[str, Any]
    holds: bool
    # The statement that took it back; None if nobody did.
    revoked_by: Statement | None = None


def statements(state: BaseState, remarks: Iterable[Remark]) -> list[Statement]:
    """Return all statements in the order in which they were said."""
    remarks = list(remarks)
    revoked = {
        each.said: _revocation(state, each)
        for each in remarks
        if isinstance(each.said, int) and each.content in state.remarks
    }
    found = [_statement(state, each, revoked.get(each.content)) for each in remarks]
    found += _no_go(state.operator.actions.values())
    return sorted(found, key=lambda each: each.stamp)


def _revocation(state: BaseState, remark: Remark) -> Statement:
    return Statement(
        'revocation',
        remark.stamp,
        remark.author,
        remark.note,
        remark.content,
        (),
        remark.words,
        {'revokes': remark.said},
        remark.content in state.remarks,
    )


def _statement(state: BaseState, remark: Remark, revoked_by: Statement | None) -> Statement:
    holds = remark.content in state.remarks and revoked_by is None
    if isinstance(remark.said, int):
        return _revocation(state, remark)
    if isinstance(remark.said, Finding):
        said = remark.said
        cells = tuple(said.cells[said.cells < state.grid.cells].tolist())
        names = ('hazard', 'target', 'confidence', 'walked', 'changed', 'since')
        kind, values = 'finding', {name: getattr(said, name) for name in names}
    else:
        key, annotation = remark.said
        path = state.paths.get(key, ())
        # A remark that nobody has judged may name any step or cell.
        cells = tuple(int(path[step]) for step in annotation.steps if step < len(path))
        holds &= _counts(state, key, annotation, remark.content)
        kind, values = (
            'annotation',
            {
                'agent': key.agent,
                'deployment': key.stamp,
                'says': annotation.kind.name,
                'report': annotation.report,
                'steps': annotation.steps,
                'by_hazard': annotation.by_hazard,
            },
        )
    return Statement(
        kind,
        remark.stamp,
        remark.author,
        remark.note,
        remark.content,
        cells,
        remark.words,
        values,
        holds,
        revoked_by,
    )


def _counts(state: BaseState, key: DeploymentKey, annotation: Annotation, content: int) -> bool:
    """Return whether a deployment stands by an annotation."""
    standing = state.standings.get(key, OPEN)
    if annotation.kind.is_of_order:
        return annotation.report == standing.report
    return content == standing.annotation


def _no_go(actions: Iterable[OperatorAction]) -> Iterator[Statement]:
    """Yield the no-go areas, each until a later action has changed all its cells back."""
    later = [each for each in actions if each.action in OF_CELLS]
    while later:
        action, *later = later
        left, by = {*action.cells}, None
        for other in later:
            if left and other.action is not action.action:
                left -= {*other.cells}
                by = None if left else other
        yield _area(action, bool(left), _area(by, True) if by else None)


def _area(action: OperatorAction, holds: bool, revoked_by: Statement | None = None) -> Statement:
    is_closed = action.action is Action.NO_GO
    return Statement(
        'no_go' if is_closed else 'lift',
        action.stamp,
        action.author,
        action.reason,
        0,
        action.cells,
        'no-go' if is_closed else 'open again',
        {},
        holds,
        revoked_by,
    )


def contradictions(said: Iterable[Statement]) -> dict[tuple[int, int], list[int]]:
    """Return the cells of which two findings in force say the opposite, by their hashes."""
    found: dict[tuple[int, int], list[int]] = defaultdict(list)
    findings = [each for each in said if each.kind == 'finding' and each.holds]
    for name in ('hazard', 'target'):
        # Findings on each cell since it was changed last.
        of_cell: dict[int, list[Statement]] = defaultdict(list)
        for one in sorted(findings, key=lambda each: (each.values['since'], each.stamp)):
            if one.values[name] is None:
                continue
            for cell in one.cells:
                if one.values['changed']:
                    of_cell[cell].clear()
                for other in of_cell[cell]:
                    if other.values[name] != one.values[name]:
                        found[other.content, one.content].append(cell)
                of_cell[cell].append(one)
    return {pair: [*dict.fromkeys(cells)] for pair, cells in found.items()}
