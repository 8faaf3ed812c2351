# SPDX-License-Identifier: Apache-2.0
"""Pictures of a mission: the believed maps beside the truth, and how they got there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.core import Belief, Grid, log_loss, Observation, World
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Number:
    """
    A number that was learnt in a mission.

    Attributes
    ----------
    quantiles : ndarray, shape (deployments + 1, 5)
        Its 5, 25, 50, 75 and 95 % quantiles, before the first deployment and after each.
    truth : float or None
        What it is, if that is known.

    """

    quantiles: NDArray[np.float64]
    truth: float | None


def mission_maps(
    path: Path,
    grid: Grid,
    belief: Belief,
    world: World,
    observations: Sequence[Observation],
    numbers: Mapping[str, Number],
    note: str = '',
) -> None:
    """
    Draw the final belief maps beside the truth, where the robots went, and what was learnt.

    Parameters
    ----------
    path : Path
        The PNG to write.
    grid : Grid
        The field.
    belief : Belief
        After the last deployment.
    world : World
        The hidden truth.
    observations : sequence of Observation
        All deployments.
    numbers : mapping of str to Number
        What was learnt besides, by name; the first of them is drawn.
    note : str
        What else is to be known of the mission.

    """
    returned = sum(o.survived for o in observations)
    lost = len(observations) - returned
    made, unknown = steps_into(grid, observations)
    panels = {
        'a': ('hazard, believed', belief.hazard, 'Reds'),
        'b': ('target, believed', belief.target, 'Greens'),
        'c': ('kappa, believed', belief.kappa, 'Purples'),
        'd': (f'steps made\n{robots(returned)} that returned', made, 'Blues'),
        'e': ('hazard, true', world.hazard, 'Reds'),
        'f': ('target, true', world.target, 'Greens'),
        'g': (
            f'steps that may not have been made\n{robots(lost)} that were lost',
            unknown,
            'Oranges',
        ),
    }
    figure = Figure(figsize=(15, 7), layout='constrained')
    axes = figure.subplot_mosaic([list('abcd'), list('efhg' if numbers else 'ef.g')])
    for name, (title, values, colours) in panels.items():
        draw_map(axes[name], grid, np.asarray(values, dtype=np.float64), colours, title)
    for name in list(numbers)[:1]:
        draw_number(axes['h'], name.replace('_', ' '), numbers[name])
    figure.suptitle(note)
    figure.savefig(path, dpi=120)


def robots(number: int) -> str:
    """Return a number of robots in words."""
    return '1 robot' if number == 1 else f'{number} robots'


def draw_map(
    axes: Axes, grid: Grid, values: NDArray[np.float64], colours: str, title: str
) -> None:
    """
    Draw one value a cell as the field is seen from above, the base as a white square.

    Parameters
    ----------
    axes : Axes
        Where.
    grid : Grid
        The field.
    values : ndarray, shape (cells,)
        Probabilities are drawn on the scale [0, 1], larger numbers up to their maximum. Blocked
        cells are grey.
    colours : str
        A matplotlib colour map.
    title : str
        Above the map.

    """
    image = np.where(grid.free, values, np.nan).reshape(grid.height, grid.width)
    left, bottom = grid.origin
    right, top = left + grid.width * grid.resolution, bottom + grid.height * grid.resolution
    drawn = axes.imshow(
        image,
        origin='lower',
        cmap=colours,
        vmin=0.0,
        vmax=max(1.0, values.max()),
        extent=(left, right, bottom, top),
    )
    axes.set_facecolor('0.6')
    ((x, y),) = grid.centers([grid.base])
    axes.plot(x, y, 's', color='white', markeredgecolor='black')
    axes.set_title(title)
    axes.set_xlabel('x (m)')
    axes.set_ylabel('y (m)')
    axes.figure.colorbar(drawn, ax=axes, shrink=0.8)


def draw_number(axes: Axes, title: str, number: Number) -> None:
    """Draw what was known of a number after each deployment, and what it is, from 0 to 1."""
    low, lower, middle, upper, high = number.quantiles.T
    deployments = np.arange(middle.size)
    axes.fill_between(deployments, low, high, color='0.85', label='90 %')
    axes.fill_between(deployments, lower, upper, color='0.65', label='50 %')
    axes.plot(deployments, middle, color='black', label='median')
    if number.truth is not None:
        axes.axhline(number.truth, color='tab:red', linestyle='--', label='truth')
    axes.set_xlim(0, max(1, middle.size - 1))
    axes.set_ylim(0, 1)
    axes.set_title(f'{title}, learnt')
    axes.set_xlabel('deployment')
    axes.grid(alpha=0.3)
    axes.legend(ncols=2)


def steps_into(
    grid: Grid, observations: Sequence[Observation]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Count the steps into each cell.

    Returns
    -------
    tuple of ndarray, shape (cells,)
        Those known to have been made: all of the robots that returned, and of lost ones as many
        as they are known to have survived; and the others of the lost ones' paths.

    """
    made, unknown = np.zeros(grid.cells), np.zeros(grid.cells)
    for observation in observations:
        known = observation.steps if observation.survived else observation.steps_survived
        entered = observation.path[1:]
        np.add.at(made, entered[:known], 1.0)
        np.add.at(unknown, entered[known:], 1.0)
    return made, unknown


def mission_progress(
    path: Path, beliefs: Sequence[Belief], world: World, observations: Sequence[Observation]
) -> None:
    """
    Draw entropy and log loss after each deployment, in nats; red ticks are lost robots.

    Parameters
    ----------
    path : Path
        The PNG to write.
    beliefs : sequence of Belief
        The prior, then one after each deployment.
    world : World
        The hidden truth.
    observations : sequence of Observation
        One a deployment.

    """
    figure = Figure(figsize=(8, 5), layout='constrained')
    axes = figure.subplots()
    axes.plot([belief.entropy() for belief in beliefs], color='black', label='entropy H(Z) + H(X)')
    for name, colour in (('hazard', 'tab:red'), ('target', 'tab:green')):
        losses = [log_loss(getattr(belief, name), getattr(world, name)) for belief in beliefs]
        axes.plot(losses, color=colour, label=f'log loss of the {name} map')
    lost = [number for number, o in enumerate(observations, start=1) if not o.survived]
    axes.plot(
        lost,
        np.zeros(len(lost)),
        '|',
        color='tab:red',
        markersize=12,
        clip_on=False,
        label=f'robot lost ({len(lost)} of {len(observations)})',
    )
    axes.set_xlim(0, max(1, len(observations)))
    axes.set_ylim(bottom=0)
    axes.set_xlabel('deployment')
    axes.set_ylabel('nats, summed over the cells')
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)
