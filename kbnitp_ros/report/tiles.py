# SPDX-License-Identifier: Apache-2.0
"""The answers of a mission in words, as a page shows them first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from kbnitp_ros.core import Decision
from kbnitp_ros.files import counted, some
from kbnitp_ros.report.answers import (
    advice,
    cells_of,
    Finding,
    findings_of,
    FOUND,
    losses_of,
)
from kbnitp_ros.report.curves import Curves
from kbnitp_ros.report.mission import Mission
import numpy as np

# How many places a tile names.
NAMED = 4


class Tile(NamedTuple):
    """A question, its answer in a few words, and a sentence on it."""

    question: str
    answer: str
    detail: str


def tiles_of(mission: Mission, curves: Curves) -> Iterator[Tile]:
    """Yield the questions of who runs a mission, with what its log answers."""
    cells, inside = cells_of(mission), mission.grid.free
    untouched = int((cells.free & ~cells.entered).sum())
    yield Tile(
        'Which cells are safe?',
        f'{cells.free.sum()} of {counted(int(inside.sum()), "cell")}',
        'free of a hazard with 95 % or more; '
        + (f'{untouched} of them were not entered' if untouched else 'all of them were entered'),
    )
    found = findings_of(mission)
    sure = [each for each in found if each.kind == 'target' and each.probability >= FOUND]
    probable = sum(each.kind == 'target' for each in found) - len(sure)
    yield Tile(
        'Where are targets? (x, y in m)',
        f'{len(sure)} found',
        f'{places(sure)} with 95 % or more; {probable} more with 50 % or more',
    )
    suspected = [each for each in found if each.kind == 'hazard']
    yield Tile(
        'Where are hazards suspected? (x, y in m)',
        counted(len(suspected), 'cell'),
        f'{places(suspected)} with 50 % or more',
    )
    unseen = int((inside & ~cells.entered).sum())
    open_cells = int((inside & ~cells.free & ~cells.suspected & cells.entered).sum())
    yield Tile(
        'What is not known?',
        f'{counted(unseen, "cell")} not entered',
        f'{open_cells} more were entered, and are neither free nor suspected',
    )
    yield lane(mission)
    entropy = curves.entropy
    share = 100.0 * entropy[-1] / entropy[0] if entropy[0] else 0.0
    yield Tile(
        'How sure is this?',
        f'{share:.0f} % uncertainty left',
        f'entropy H(Z) + H(X): {entropy[-1]:.1f} of {entropy[0]:.1f} nats. {risk(mission)}',
    )
    ended = mission.ended
    lost = sum(not each.survived for each in ended)
    yield Tile(
        'What did it cost?',
        f'{lost} of {counted(len(ended) + mission.in_flight, "robot")} lost',
        f'{len(ended) - lost} returned, {mission.in_flight} in flight',
    )
    yield where_lost(mission, lost)
    yield fit(mission)
    answer, why = advice(mission)
    yield Tile('What to do next?', answer, why)


def lane(mission: Mission) -> Tile:
    """Return what is said of the lane, or of another goal."""
    decision = mission.decision
    if decision is None:
        goals = {str(each.get('goal.kind', 'map')) for each in mission.parameters.values()}
        given = goals - {'', 'map'}
        return Tile(
            'Is the lane safe?',
            'No decision yet' if given else 'No goal was given',
            'set goal.kind to lane or area to have robots sent for it',
        )
    question = 'Is the lane safe?' if decision.goal == 'lane' else f'Is the {decision.goal} safe?'
    return Tile(
        question,
        f'{100.0 * decision.p_free:.1f} % free of hazards',
        f'{survived(decision)}{decision.hazards_mean:.2f} hazards expected. '
        + ('The goal is reached.' if decision.reached else 'The goal is not reached.'),
    )


def survived(decision: Decision) -> str:
    """Return how probably a robot survives the lane; empty if there is none."""
    if not decision.path.size:
        return ''
    steps = counted(decision.path.size - 1, 'step')
    return f'a robot survives its {steps} with {100.0 * decision.survival:.1f} %; '


def risk(mission: Mission) -> str:
    """Return how lethal a hazard is believed to be."""
    last = mission.moments[-1]
    if 'lethality' not in last.learnt:
        return f'Lethality: {100.0 * last.model.lethality:.0f} % (given).'
    low, _, middle, _, high = (100.0 * each for each in last.learnt['lethality'].quantiles)
    return f'Lethality: {middle:.0f} % (learnt, {low:.0f} to {high:.0f} %).'


def fit(mission: Mission) -> Tile:
    """Return whether the evidence fits the model, and the kind of hazards where it is learnt."""
    question, (_, kinds, check) = 'Does the model fit?', mission.moments[-1].state
    if not check.alternatives:
        return Tile(question, 'Not checked', check.reason or 'the log has no check of the model')
    learnt = ', '.join(
        f'{kind.replace("_", " ")} {100.0 * probability:.0f} %'
        for kind, probability in kinds.items()
    )
    details = [f'Hazards: {learnt}.'] if len(kinds) > 1 else []
    details += [f'{check.reason[0].upper()}{check.reason[1:]}.']
    if mission.rules['dynamics'] == 'static':
        details.append('Moving hazards hardly show in returns.')
    return Tile(
        question, 'In doubt' if check.is_in_doubt else 'Nothing against it', ' '.join(details)
    )


def where_lost(mission: Mission, lost: int) -> Tile:
    """Return in which cell most robots are expected to have been lost."""
    question = 'Where were robots lost? (x, y in m)'
    if not lost:
        return Tile(question, 'No robot was lost', 'every robot that reported returned')
    losses = losses_of(mission)
    most = int(np.argmax(losses))
    x, y = mission.grid.centers([most])[0]
    return Tile(
        question,
        f'most at ({x:g}, {y:g})',
        f'{losses[most]:.1f} of {lost} expected there; the map of losses has every cell',
    )


def places(findings: list[Finding]) -> str:
    """Return where findings are, the first of them."""
    if not findings:
        return 'none'
    return some((f'({each.x:g}, {each.y:g})' for each in findings), NAMED)
