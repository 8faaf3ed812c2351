# SPDX-License-Identifier: Apache-2.0
"""Random cases for the checks of laws, and the error of a broken law."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from kbnitp_ros.core import Belief, Grid, Observation, ORDINARY, RobotType, SensorModel, World
from kbnitp_ros.plugins import Registry
import numpy as np
from numpy.typing import NDArray

Subject = TypeVar('Subject')
Case = TypeVar('Case')

# Tolerance of rounding.
ROUNDING = 1e-9


def hold(
    registry: Registry[Subject],
    given: object,
    laws: Iterable[Callable[[Subject, Case], None]],
    draw: Callable[[int], Case],
    cases: int,
    seed: int,
) -> None:
    """Check laws, stated in their docstrings, in random cases with the seeds from `seed` on."""
    name = f'{registry.kind} {given!r}'
    if isinstance(given, str):
        subject = registry.find(given)
    else:
        try:
            subject = registry.check(given)
        except (TypeError, ValueError) as error:
            raise AssertionError(f'{name} is invalid: {error}') from error
    for number in range(seed, seed + cases):
        case = draw(number)
        for check in laws:
            try:
                check(subject, case)
            except Exception as error:
                law = str(check.__doc__).removeprefix('Check that ').removesuffix('.')
                words = str(error) if type(error) is AssertionError else with_type(error)
                raise AssertionError(
                    f'{name} breaks a law with seed {number}: {law}. {words}'
                ) from error


def require(holds: bool | np.bool_, words: str) -> None:
    """Raise an AssertionError unless a condition holds; python -O would ignore `assert`."""
    if not holds:
        raise AssertionError(words)


def require_close(
    found: NDArray[np.float64], expected: NDArray[np.float64], words: str, within: float = ROUNDING
) -> None:
    """Raise an AssertionError that shows where two arrays first differ."""
    require(
        found.shape == expected.shape,
        f'{words}: the shape is {found.shape} and must be {expected.shape}',
    )
    off = ~(np.abs(found - expected) <= within)
    if off.any():
        place = tuple(int(index) for index in np.argwhere(off)[0])
        raise AssertionError(
            f'{words}: at {list(place)} it is {found[place]} and must be {expected[place]}'
        )


def require_same(one: Belief, other: Belief, words: str) -> None:
    """Raise an AssertionError that shows where two beliefs first differ, bit for bit."""
    if one.joint.tobytes() != other.joint.tobytes():
        require_close(one.joint, other.joint, words, 0.0)
        raise AssertionError(f'{words}: the bits differ')


def with_type(error: Exception) -> str:
    """Return an error with its type."""
    return f'{type(error).__name__}: {error}'


# Seeds of the generators of cases, different from the seeds of worlds.
MISSIONS, PLANS = 0x4C415753, 0x4C415754


@dataclass(frozen=True, eq=False)
class FieldCase:
    """A small field and the belief about it."""

    # At most 4 x 4 cells, some of them blocked.
    grid: Grid
    # Arbitrary prior in each cell; some cells are known to be free of hazard.
    prior: Belief
    # Sensor model with a malfunction rate above 0.
    model: SensorModel


@dataclass(frozen=True, eq=False)
class MissionCase(FieldCase):
    """A field and the observations of a mission in it."""

    # Seed of the method's random draws.
    seed: int
    # Outcomes in one world that is possible under the prior, with and without last contacts, with
    # missing readings, and with steps that the robot cannot vouch for.
    deployments: tuple[tuple[Observation, RobotType], ...]
    # Maximum error of a probability by the method.
    tolerance: float = ROUNDING

    @property
    def returns(self) -> tuple[tuple[Observation, RobotType], ...]:
        """Return the observations of returned robots."""
        return tuple(each for each in self.deployments if each[0].survived)


def draw_field(rng: np.random.Generator) -> FieldCase:
    """Draw a field."""
    width, height = (int(n) for n in rng.integers(2, 5, 2))
    base, *others = (int(cell) for cell in rng.permutation(width * height))
    grid = Grid(width, height, base=base, blocked=others[: int(rng.integers(0, 3))])
    hazard = rng.uniform(0.02, 0.9, grid.cells) * (rng.random(grid.cells) < 0.8)
    kappa, background = rng.uniform(0.05, 0.95, (2, grid.cells))
    target = hazard * kappa + (1.0 - hazard) * background
    return FieldCase(grid, Belief.prior(grid, hazard, target, kappa), draw_model(rng))


def draw_model(rng: np.random.Generator) -> SensorModel:
    """Draw a sensor model under which every outcome is possible."""
    return SensorModel(
        lethality=float(rng.uniform(0.1, 0.95)),
        malfunction=float(rng.uniform(0.01, 0.15)),
        false_negative=float(rng.uniform(0.0, 0.2)),
        true_positive=float(rng.uniform(0.7, 0.99)),
        false_positive=float(rng.uniform(0.01, 0.3)),
    )


def draw_robot_type(rng: np.random.Generator) -> RobotType:
    """Draw a robot type, with or without numbers of its own."""
    drawn = draw_model(rng)
    own = [name for name in vars(drawn) if name in vars(ORDINARY) and rng.random() < 0.3]
    return RobotType(**{name: getattr(drawn, name) for name in own})


def draw_walk(rng: np.random.Generator, grid: Grid, steps: int) -> NDArray[np.intp]:
    """Draw a closed walk with this number of steps, at least 1."""
    path = [grid.base]
    for left in reversed(range(steps)):
        around = grid.neighbors(path[-1])
        path.append(int(rng.choice(around[grid.steps_to_base[around] <= left])))
    return np.array(path, dtype=np.intp)


def draw_outcome(
    rng: np.random.Generator, world: World, path: NDArray[np.intp], model: SensorModel
) -> Observation:
    """Draw the observation of a robot on a path."""
    survived, read, _ = world.steps(path, model, rng)
    if survived.all():
        entered = rng.random(read.size) < rng.choice([0.7, 1.0])
        return Observation(
            path, True, np.where(rng.random(read.size) < 0.1, -1, read), entered=entered
        )
    contact = int(rng.integers(0, survived.argmin() + 1)) if rng.random() < 0.4 else 0
    return Observation(path, False, steps_survived=contact)


def draw_mission(seed: int, robots: int = 6, tolerance: float = ROUNDING) -> MissionCase:
    """Draw a mission; its last two robots are a lost robot and a returned robot."""
    rng = np.random.default_rng([MISSIONS, seed])
    field = draw_field(rng)
    below = np.cumsum(field.prior.joint.reshape(-1, 4), axis=1)
    state = (rng.random((field.prior.cells, 1)) * below[:, -1:] >= below).sum(axis=1)
    world = World(state // 2 == 1, state % 2 == 1)
    deployments = []
    for _ in range(robots):
        robot_type = draw_robot_type(rng) if rng.random() < 0.4 else ORDINARY
        path = draw_walk(rng, field.grid, int(rng.integers(1, 9)))
        deployments.append(
            (draw_outcome(rng, world, path, robot_type.model(field.model)), robot_type)
        )
    # These two outcomes are possible in every world.
    one, other = (draw_walk(rng, field.grid, int(rng.integers(2, 9))) for _ in range(2))
    back = Observation(other, True, rng.random(other.size - 1) < 0.5)
    deployments += [(Observation(one, False), ORDINARY), (back, ORDINARY)]
    case = field.grid, field.prior, field.model, seed, tuple(deployments)
    return MissionCase(*case, tolerance)
