# SPDX-License-Identifier: Apache-2.0
"""Answers of a mission: safe cells, targets, losses and what to do next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from typing import Any, NamedTuple

from kbnitp_ros.core import Observation, targets, World
from kbnitp_ros.core.inference.filter import hazards_used_up
from kbnitp_ros.files import counted, some
from kbnitp_ros.report.mission import DeploymentSummary, MissionSummary
from kbnitp_ros.report.tables import Curves
import numpy as np
from numpy.typing import NDArray

# Maximum P(hazard) of a free cell, and minimum P(hazard) of a suspected hazard.
FREE, SUSPECTED = 0.05, 0.5
# Minimum P(target) of a target found, and of a target listed.
FOUND, LISTED = 0.95, 0.5

# The last reports give the pace of a mission: this share of all reports, at least this number.
LAST, MIN_ROBOTS = 0.25, 5


@dataclass(frozen=True, eq=False)
class Cells:
    """Classes of cells by the last belief, each of shape (cells,)."""

    # A robot is known to have entered the cell, or it is a base.
    entered: NDArray[np.bool_]
    # Entered, and free of a hazard with a probability of at least 95 %.
    free: NDArray[np.bool_]
    # Not entered, and free with that probability by the prior and what was learnt elsewhere.
    assumed: NDArray[np.bool_]
    # On the path of a robot, and with a probability of a hazard of at least 50 %.
    suspected: NDArray[np.bool_]


def classify_cells(mission: MissionSummary) -> Cells:
    """Return the classes of cells, without blocked cells."""
    hazard, inside = mission.moments[-1].belief.hazard, mission.grid.free
    entered, free = mission.entered() & inside, inside & (hazard <= FREE)
    suspected = mission.visited() & inside & (hazard >= SUSPECTED)
    return Cells(entered, entered & free, free & ~entered, suspected)


def list_findings(mission: MissionSummary) -> list[dict[str, Any]]:
    """Return the targets and the suspected hazards as rows of a table, the most probable first."""
    belief, model = mission.moments[-1].belief, mission.moments[-1].snapshot.model
    known = {each.cell: each for each in targets(belief, model, mission.ended)}
    suspected = np.flatnonzero(classify_cells(mission).suspected).tolist()
    found = [
        *(('target', cell, each.probability) for cell, each in known.items()),
        *(('hazard', cell, float(belief.hazard[cell])) for cell in suspected),
    ]
    table = [
        {
            'kind': kind,
            'cell': cell,
            'probability': probability,
            # Number of readings in the cell, and number of positive readings.
            'looks': known[cell].looks,
            'seen': known[cell].found,
        }
        for kind, cell, probability in sorted(found, key=lambda each: (-each[2], each[:2]))
        if probability >= LISTED and mission.grid.free[cell]
    ]
    return placed(mission, table)


def placed(mission: MissionSummary, table: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows with the centres of their cells in metres and, with a datum, in degrees."""
    centers = mission.grid.centers([row['cell'] for row in table])
    columns = dict(zip('xy', centers.T.tolist()))
    if mission.datum is not None:
        columns |= zip(('latitude', 'longitude'), mission.datum.on_earth(centers).T.tolist())
    return [row | dict(zip(columns, place)) for row, place in zip(table, zip(*columns.values()))]


def metres(value: float) -> str:
    """Round metres to millimetres, as pages and tables show them."""
    return f'{round(value, 3) + 0.0:.12g}'


def spot(x: float, y: float) -> str:
    """Return the name of a cell by its centre in metres."""
    return f'({metres(x)}, {metres(y)})'


# Maximum number of safe cells listed on a page.
MAX_SAFE = 1000


def safe_cells(mission: MissionSummary) -> list[dict[str, Any]]:
    """Return the free cells as rows of a table, the safest first, at most `MAX_SAFE`."""
    grid, belief = mission.grid, mission.moments[-1].belief
    free = np.flatnonzero(classify_cells(mission).free)
    listed = free[np.argsort(belief.hazard[free], kind='stable')][:MAX_SAFE]
    losses = expected_losses(mission)
    # Counterclockwise and closed, as in RFC 7946.
    ring = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    lower_left = np.stack([listed % grid.width, listed // grid.width], axis=-1)
    corners: NDArray[np.float64] = grid.in_metres(lower_left[:, None] + ring).reshape(-1, 2)
    if mission.datum is not None:
        # Longitude before latitude, as in RFC 7946.
        corners = mission.datum.on_earth(corners)[:, ::-1]
    table = [
        {
            'cell': cell,
            'hazard': belief.hazard[cell],
            'target': belief.target[cell],
            # In a cell that is free of a hazard a robot fails by itself.
            'malfunctions': losses[cell],
            'corners': around,
        }
        for cell, around in zip(listed.tolist(), corners.reshape(-1, 5, 2).tolist())
    ]
    return placed(mission, table)


def expected_losses(mission: MissionSummary) -> NDArray[np.float64]:
    """Return the expected number of robots lost in each cell, shape (cells,)."""
    expected = np.zeros(mission.grid.cells)
    for deployment in mission.deployments:
        seen = deployment.outcome
        if seen is not None and not seen.survived:
            np.add.at(expected, seen.path[1:], loss_shares(mission, deployment, seen))
    return expected


def loss_shares(
    mission: MissionSummary, deployment: DeploymentSummary, seen: Observation
) -> NDArray[np.float64]:
    """Return P(step | lost) by the last belief, or that after the report if hazards change."""
    stays = mission.dynamics == 'static' or deployment.moment is None
    moment = mission.moments[-1 if stays or deployment.moment is None else deployment.moment]
    hazard = moment.belief.hazard[seen.path[1:]]
    return shares(seen, moment.agent_model(deployment.key.agent).survival(hazard))


def expected_used_up(mission: MissionSummary) -> NDArray[np.float64]:
    """Return the expected number of hazards used up in each cell, shape (cells,)."""
    used_up = np.zeros(mission.grid.cells)
    for deployment in mission.deployments:
        if deployment.moment:
            used_up += used_up_at(mission, deployment.moment)
    return used_up


def used_up_at(mission: MissionSummary, place: int) -> NDArray[np.float64]:
    """Return the expected number of hazards that a deployment uses up, in each cell."""
    moment, before = mission.moments[place], mission.moments[place - 1].belief
    if moment.outcome is None or moment.deployment is None:
        return np.zeros(mission.grid.cells)
    model = moment.agent_model(mission.deployments[moment.deployment].key.agent)
    return hazards_used_up(before, model, moment.outcome)


def shares(seen: Observation, survival: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probability of a loss in each step, given the survival of each step."""
    after_contact = np.arange(seen.steps) >= seen.steps_survived
    fits = after_contact if seen.lost_at is None else seen.lost_at
    reached = np.concatenate([[1.0], np.cumprod(survival[:-1])])
    lost = fits * reached * (1.0 - survival)
    if not lost.any():
        lost = fits
    share: NDArray[np.float64] = lost / lost.sum()
    return share


def advice(mission: MissionSummary) -> tuple[str, str]:
    """Return the recommended action, in a few words, and the reason."""
    out, decision = mission.in_flight, mission.decision
    if decision is not None and decision.reached:
        return 'Stop', f'The goal {decision.goal} is reached.'
    if out:
        return 'Wait', f'No report yet from {counted(out, "robot")}.'
    if decision is not None:
        return 'Send more', f'{decision.goal}: {decision.reason}.'
    return pace(mission)


def pace(mission: MissionSummary) -> tuple[str, str]:
    """Estimate the number of further robots for the undecided cells, and explain the estimate."""
    moments = mission.moments
    left = undecided(mission, -1)
    if not left:
        return 'Stop', 'All cells are decided: free or hazardous with 95 % or more.'
    if len(moments) < 2:
        said = f'No report has changed the belief. Undecided: {counted(left, "cell")}.'
        return 'Send robots', said
    robots = min(len(moments) - 1, max(MIN_ROBOTS, int(LAST * (len(moments) - 1))))
    decided = undecided(mission, -1 - robots) - left
    since = {each.deployment: each.outcome for each in moments[-robots:] if each.outcome}
    lost = sum(not each.survived for each in since.values())
    said = f'The last {counted(robots, "report")} decided {counted(max(0, decided), "cell")}'
    cost = f'{lost} were losses' if lost != 1 else '1 was a loss'
    if decided <= 0:
        return (
            'Stop',
            f'{said}, and {cost}. More robots bring little to the {left} undecided cells.',
        )
    more = ceil(left * robots / decided)
    return (
        f'About {counted(more, "robot")} more',
        f'{said}; {cost}. The estimate is for the {left} undecided cells, at this pace.',
    )


def undecided(mission: MissionSummary, moment: int) -> int:
    """Return the number of cells that are neither free nor hazardous with 95 % at a moment."""
    hazard = mission.moments[moment].belief.hazard[mission.grid.free]
    return int(((hazard > FREE) & (hazard < 1.0 - FREE)).sum())


# Maximum number of places named in a tile.
NAMED = 4


class Tile(NamedTuple):
    """A question, its answer in a few words, and an explanation."""

    question: str
    answer: str
    detail: str
    # The id of the part of the page with all details; empty if there is none.
    link: str = ''


def answer_tiles(mission: MissionSummary, curves: Curves) -> Iterator[Tile]:
    """Yield the questions of a field engineer with the answers of a log."""
    cells, inside = classify_cells(mission), mission.grid.free
    assumed = int(cells.assumed.sum())
    among = mission.moments[-1].belief.hazard[cells.free].sum()
    yield Tile(
        'Which cells are safe?',
        f'{cells.free.sum()} of {counted(int(inside.sum()), "cell")}',
        'entered, and free of a hazard with 95 % or more; '
        + (f'{counted(assumed, "cell")} more without a visit, by the prior. ' if assumed else '')
        + f'{brief(among)} hazards are expected in the safe cells',
        'safe-title',
    )
    found = list_findings(mission)
    sure = [each for each in found if each['kind'] == 'target' and each['probability'] >= FOUND]
    probable = sum(each['kind'] == 'target' for each in found) - len(sure)
    yield Tile(
        'Where are targets? (x, y in m)',
        f'{len(sure)} found',
        f'{places(sure)} with 95 % or more; {probable} more with 50 % or more',
        'findings-title',
    )
    suspected = [each for each in found if each['kind'] == 'hazard']
    yield Tile(
        'Where are hazards suspected? (x, y in m)',
        counted(len(suspected), 'cell'),
        f'{places(suspected)} with 50 % or more',
        'findings-title',
    )
    unseen = int((inside & ~cells.entered).sum())
    open_cells = int((cells.entered & ~cells.free & ~cells.suspected).sum())
    yield Tile(
        'What is not known?',
        f'{counted(unseen, "cell")} not entered',
        f'{open_cells} cells were entered, and are neither safe nor suspected',
        'map-title',
    )
    yield lane(mission)
    entropy = curves.entropy
    share = 100.0 * entropy[-1] / entropy[0] if entropy[0] else 0.0
    yield Tile(
        'How sure is this?',
        f'{share:.0f} % of the uncertainty of the map left',
        f'{entropy[-1]:.1f} of {entropy[0]:.1f} nats of entropy. {risk(mission)}',
        'curves-title',
    )
    ended = mission.robots
    lost = sum(not each.survived for each in ended)
    yield Tile(
        'What did it cost?',
        f'{lost} of {counted(len(ended) + mission.in_flight, "robot")} lost',
        f'{len(ended) - lost} returned, {mission.in_flight} in flight',
        'table-title',
    )
    yield where_lost(mission, lost)
    yield fit(mission)
    answer, why = advice(mission)
    yield Tile('What to do next?', answer, why)


# A hazard that never strikes leaves no evidence but its target.
DUDS = ' Free of hazards that can strike: a hazard that never strikes, a dud, is not found.'


def lane(mission: MissionSummary) -> Tile:
    """Describe the decision on the lane, or on another goal."""
    decision = mission.decision
    if decision is None:
        goals = {str(each.get('goal.kind', 'map')) for each in mission.parameters.values()}
        given = goals - {'', 'map'}
        return Tile(
            'Is the lane safe?',
            'No decision yet' if given else 'No goal was given',
            'set goal.kind to lane or area to send robots for a goal',
            'map-title',
        )
    method = mission.moments[-1].snapshot.method
    taken = '' if method == 'kappa_bnitp_sampled' else f' {method} assumes independent cells.'
    question = 'Is the lane safe?' if decision.goal == 'lane' else f'Is the {decision.goal} safe?'
    survived, error = '', ''
    if decision.error >= 0.0005:
        error = f' (± {100.0 * decision.error:.1f})'
    if decision.path.size:
        steps = counted(decision.path.size - 1, 'step')
        survived = f'a robot survives the {steps} with {100.0 * decision.survival:.1f} %; '
    return Tile(
        question,
        f'Free of hazards with {100.0 * decision.p_free:.1f} %{error}',
        f'{survived}{decision.hazards_mean:.2f} hazards expected. '
        + ('The goal is reached.' if decision.reached else 'The goal is not reached.')
        + taken
        + ''.join(f' The decision {sentence}.' for sentence in decision.trusts)
        + ('' if mission.moments[-1].belief.duds is not None else DUDS),
        'map-title',
    )


def risk(mission: MissionSummary) -> str:
    """Describe the lethality of hazards."""
    last = mission.moments[-1]
    if 'lethality' not in last.state.numbers:
        return f'Lethality: {100.0 * last.snapshot.model.lethality:.0f} % (given).'
    low, _, middle, _, high = (100.0 * each for each in last.state.numbers['lethality'].quantiles)
    return f'Lethality: {middle:.0f} % (learnt, {low:.0f} to {high:.0f} %).'


def fit(mission: MissionSummary) -> Tile:
    """Describe the recorded truth and the model check, which show how reliable the answers are."""
    question, (_, kinds, checked) = 'Can I trust it?', mission.moments[-1].state
    check = checked.check
    right = f'{by_truth(mission, mission.world)} ' if mission.world else ''
    if not check.alternatives:
        why = check.reason or 'the log has no check of the model'
        return Tile(question, 'The model is not checked', f'{right}{why}', 'curves-title')
    learnt = ', '.join(
        f'{kind.replace("_", " ")} {100.0 * probability:.0f} %'
        for kind, probability in kinds.items()
    )
    details = [f'Hazards: {learnt}.'] if len(kinds) > 1 else []
    after = counted(checked.deployments, 'deployment')
    details += [f'{check.reason[0].upper()}{check.reason[1:]} (checked after {after}).']
    if mission.dynamics == 'static':
        details.append('Returns hardly reveal moving hazards.')
    answer = 'The model is in doubt' if check.is_in_doubt else 'The evidence fits the model'
    return Tile(question, answer, right + ' '.join(details), 'curves-title')


def by_truth(mission: MissionSummary, world: World) -> str:
    """Describe the true state of free and suspected cells."""
    cells, inside = classify_cells(mission), mission.grid.free
    missed = int((world.hazard & cells.free).sum())
    return (
        f'By the recorded truth {cells.free.sum() - missed} of {cells.free.sum()} safe cells '
        f'have no hazard, {(world.hazard & cells.suspected).sum()} of {cells.suspected.sum()} '
        f'suspected cells have one, and {missed} of {(world.hazard & inside).sum()} hazards are '
        'in safe cells.'
    )


def where_lost(mission: MissionSummary, lost: int) -> Tile:
    """Describe the cells in which half of the losses are expected."""
    question = 'Where were robots lost? (x, y in m)'
    if not lost:
        return Tile(question, 'No robot was lost', 'all robots with a report returned')
    losses, safe = expected_losses(mission), classify_cells(mission).free
    most = np.argsort(-losses, kind='stable')
    half = int(np.searchsorted(losses[most].cumsum(), lost / 2)) + 1
    first = most[: min(half, NAMED)]
    named = [
        f'{losses[cell]:.1f} at {spot(*place)}{" (malfunctions)" if safe[cell] else ""}'
        for cell, place in zip(first, mission.grid.centers(first))
    ]
    return Tile(
        question,
        f'Half of the losses in {counted(half, "cell")}',
        f'expected losses: {", ".join(named)}; all cells are in the map of robots lost',
        'colour-robots-lost',
    )


def brief(number: float) -> str:
    """Return a number with two digits, and without an exponent."""
    if number >= 10.0:
        return f'{number:.0f}'
    return f'{number:.2g}' if number >= 0.01 else 'less than 0.01'


def places(findings: list[dict[str, Any]]) -> str:
    """Return the places of the first findings."""
    if not findings:
        return 'none'
    return some((spot(each['x'], each['y']) for each in findings), NAMED)
