# SPDX-License-Identifier: Apache-2.0
"""
Missions in which numbers, rates or kinds of hazard are learnt, and the check of the model.

``python3 benchmarks/learning.py STUDY --worlds N --out FILE.csv`` appends a row for each
estimator and world, and ``python3 benchmarks/learning.py summary FILE.csv`` prints the means.
Studies are numbers, coverage, missions, rates, kinds and check.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import as_completed, ProcessPoolExecutor
from functools import partial
import os
from pathlib import Path
import sys

from kbnitp_ros.core import (
    Belief,
    Beta,
    Dynamics,
    Estimator,
    Grid,
    Learning,
    log_loss,
    Observation,
    plan,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
import numpy as np
import pandas as pd
from tqdm import tqdm

GRID, STATIC, MODEL = Grid(9, 9), Dynamics(), SensorModel(0.5)
DENSITY, KAPPA, BACKGROUND = 0.15, 0.8, 0.1
PRIOR = Belief.prior(GRID, DENSITY, DENSITY * KAPPA + (1 - DENSITY) * BACKGROUND, KAPPA)
TWO = Unknowns(lethality=(0.0, 1.0), hazard_density=Beta(1.5, 5.0))
SEVEN = Unknowns(
    lethality=(0.0, 1.0),
    malfunction=Beta(2.0, 30.0),
    hazard_density=Beta(1.5, 5.0),
    kappa=(0.0, 1.0),
    target_background=(0.0, 0.5),
    true_positive=(0.5, 1.0),
    false_positive=(0.0, 0.5),
)
LETHALITIES = (0.1, 0.3, 0.5, 0.9)
UNKNOWN = {
    'changing': Dynamics('changing', vanish=(0.001, 0.1)),
    'moving': Dynamics('moving', move=(0.001, 0.1)),
}


def true_dynamics(kind: str, rate: float = 0.0) -> Dynamics:
    """Return dynamics of a kind that keep the expected number of hazards."""
    if kind == 'changing':
        return Dynamics(kind, rate * DENSITY / (1 - DENSITY), rate)
    return Dynamics(kind, move=rate if kind == 'moving' else 0.0)


def fly(seed, lethality, robots, dynamics=STATIC, **kwargs):
    """Return a mission of a relaxed planner that knows the truth unless given otherwise."""
    world = World.random(GRID, np.random.default_rng([seed, 1]), DENSITY, KAPPA, BACKGROUND)
    rng = np.random.default_rng([seed, 2])
    kwargs = {'options': SearchOptions('relaxed'), 'dynamics': dynamics, **kwargs}
    model = kwargs.pop('model', SensorModel(lethality))
    return run_mission(GRID, PRIOR, model, kwargs.pop('world', world), robots, rng, **kwargs)


def fold(observations, model=MODEL, **kwargs):
    """Return an estimator after these outcomes."""
    estimator = Estimator(kwargs.pop('prior', PRIOR), model, **kwargs)
    for observation in observations:
        estimator.assimilate(observation)
    return estimator


def hazard_loss(estimator, world):
    return log_loss(estimator.belief.hazard, world.hazard)


def numbers(seed: int) -> Iterator[dict]:
    """Bank and sampler on the same evidence."""
    for lethality in LETHALITIES:
        mission = fly(seed, lethality, 100)
        observations = [deployment.observation for deployment in mission]
        for name, unknowns in (('two', TWO), ('seven', SEVEN)):
            for method in ('kappa_bnitp', 'kappa_bnitp_sampled'):
                estimator = fold(observations, method=method, unknowns=unknowns, seed=seed)
                known = estimator.parameters['lethality']
                yield {
                    'case': f'{name} {lethality}',
                    'estimator': method,
                    'loss': hazard_loss(estimator, mission[-1].world),
                    'mean': known.mean,
                    'sd': known.sd,
                }


def coverage(seed: int) -> Iterator[dict]:
    """Share of 90 % intervals that contain numbers drawn from the prior."""
    for name, unknowns in (('two', TWO), ('seven', SEVEN)):
        rng = np.random.default_rng([seed, 3])
        true = {
            each: prior.low + (prior.high - prior.low) * rng.beta(prior.a, prior.b)
            if prior.a == prior.b == 1.0
            else rng.beta(prior.a, prior.b)
            for each, prior in unknowns.priors.items()
        }
        density = true['hazard_density']
        kappa, background = true.get('kappa', KAPPA), true.get('target_background', BACKGROUND)
        sensor = {each: value for each, value in true.items() if hasattr(SensorModel(0.5), each)}
        world = World.random(GRID, rng, density, kappa, background)
        model = SensorModel(**{'lethality': 0.5, **sensor})
        mission = fly(seed, 0.5, 100, world=world, truth=Truth(model=model))
        estimator = fold([each.observation for each in mission], unknowns=unknowns, seed=seed)
        for each, value in true.items():
            known = estimator.parameters[each]
            holds = known.quantile(0.05) <= value <= known.quantile(0.95)
            yield {'case': f'{name} {each}', 'estimator': 'bank', 'holds': float(holds)}


def missions(seed: int) -> Iterator[dict]:
    """Bank and sampler, each on the paths of its own belief."""
    for lethality in LETHALITIES:
        for method in ('kappa_bnitp', 'kappa_bnitp_sampled'):
            mission = fly(
                seed,
                lethality,
                100,
                method=method,
                model=SensorModel(0.5),
                truth=Truth(model=SensorModel(lethality)),
                learning=Learning(TWO),
            )
            yield {
                'case': f'own paths {lethality}',
                'estimator': method,
                'loss': log_loss(mission[-1].belief.hazard, mission[-1].world.hazard),
                'lost': sum(not deployment.observation.survived for deployment in mission),
            }


def rates(seed: int) -> Iterator[dict]:
    """Unknown lethality of used-up hazards, and unknown rates, against known ones."""
    for lethality in (0.3, 0.5, 0.9):
        mission = fly(seed, lethality, 60, Dynamics('used_up'))
        observations = [deployment.observation for deployment in mission]
        for name, kwargs in (
            ('told', {'model': SensorModel(lethality)}),
            ('learnt', {'unknowns': Unknowns(lethality=(0.0, 1.0)), 'seed': seed}),
        ):
            estimator = fold(observations, dynamics=Dynamics('used_up'), **kwargs)
            yield {
                'case': f'used up {lethality}',
                'estimator': name,
                'loss': hazard_loss(estimator, mission[-1].world),
            }
    for kind in ('changing', 'moving'):
        for rate in (0.005, 0.02):
            true = true_dynamics(kind, rate)
            mission = fly(seed, 0.5, 200, true)
            observations = [each.observation for each in mission]
            for name, dynamics in (('told', true), ('learnt', UNKNOWN[kind])):
                estimator = fold(observations, dynamics=dynamics, seed=seed)
                yield {
                    'case': f'{kind} {rate}',
                    'estimator': name,
                    'loss': hazard_loss(estimator, mission[-1].world),
                }


def kinds(seed: int) -> Iterator[dict]:
    """Learnt kinds, against the known kind and assumed static hazards."""
    fields = [('static', 0.0), ('used_up', 0.0)]
    fields += [(kind, rate) for kind in ('changing', 'moving') for rate in (0.002, 0.005, 0.02)]
    for kind, rate in fields:
        true = true_dynamics(kind, rate)
        mission = fly(seed, 0.5, 150, true)
        observations = [deployment.observation for deployment in mission]
        world = mission[-1].world
        case = f'{kind} {rate}' if rate else kind
        yield {'case': case, 'estimator': 'prior', 'loss': log_loss(PRIOR.hazard, world.hazard)}
        for name, dynamics in (
            ('told', true),
            ('learnt', Dynamics('learn')),
            ('static', Dynamics()),
        ):
            estimator = fold(observations, dynamics=dynamics, seed=seed)
            row = {'case': case, 'estimator': name, 'loss': hazard_loss(estimator, world)}
            if name == 'learnt':
                family = {'moving': 'changing'}
                found = dict.fromkeys(('static', 'used_up', 'changing'), 0.0)
                for each, probability in estimator.kinds.items():
                    found[family.get(each, each)] += probability
                row['holds'] = float(max(found, key=found.get) == family.get(kind, kind))
            yield row


def check(seed: int) -> Iterator[dict]:
    """Share of missions in doubt, with a correct and with a wrong model."""
    static, right = Dynamics(), SensorModel(0.5)
    moving = true_dynamics('moving', 0.02)
    used_up = Dynamics('used_up')
    cases = {
        'right': (fly(seed, 0.5, 100), right),
        'used up': (fly(seed, 0.5, 100, static, truth=Truth(dynamics=used_up)), right),
        'moving .02': (fly(seed, 0.5, 100, static, truth=Truth(dynamics=moving)), right),
        'malfunction .10 for .05': (
            fly(seed, 0.5, 100, truth=Truth(model=SensorModel(0.5, 0.1))),
            right,
        ),
        'lethality .2 for .5': (fly(seed, 0.5, 100, truth=Truth(model=SensorModel(0.2))), right),
        'blasts': (with_blasts(seed), right),
    }
    for name, (mission, model) in cases.items():
        observations = [getattr(each, 'observation', each) for each in mission]
        for estimator, unknowns in (('told', Unknowns()), ('learning', TWO)):
            found = fold_checked(observations, model, unknowns, seed)
            yield {'case': name, 'estimator': estimator, 'holds': float(found)}
    # Learning with numbers drawn from their prior.
    rng = np.random.default_rng([seed, 4])
    density, lethality = rng.beta(1.5, 5.0), rng.random()
    world = World.random(GRID, rng, density, KAPPA, BACKGROUND)
    mission = fly(seed, 0.5, 100, world=world, truth=Truth(model=SensorModel(lethality)))
    observations = [deployment.observation for deployment in mission]
    found = fold_checked(observations, SensorModel(0.5), TWO, seed)
    yield {'case': 'right, from the prior', 'estimator': 'learning', 'holds': float(found)}


def fold_checked(observations, model, unknowns, seed):
    """Return whether the check was ever in doubt."""
    return fold(observations, model, unknowns=unknowns, seed=seed).check.is_in_doubt


def with_blasts(seed: int) -> list[Observation]:
    """Return a mission in which hazards reach adjacent cells with 15 %."""
    rng = np.random.default_rng([seed, 5])
    world = World.random(GRID, rng, DENSITY, KAPPA, BACKGROUND)
    model, estimator = SensorModel(0.5), Estimator(PRIOR, SensorModel(0.5))
    deadly = model.lethality * (1 - model.false_negative)
    around = np.array([world.hazard[GRID.neighbors(cell)].sum() for cell in range(GRID.cells)])
    survive = (1 - model.malfunction) * (1 - deadly * world.hazard)
    survive *= (1 - 0.15) ** (around - world.hazard)
    observations = []
    for _ in range(100):
        path = plan(GRID, estimator.belief, model, SearchOptions('relaxed', 18)).path
        steps = path[1:]
        if (rng.random(steps.size) < survive[steps]).all():
            reading = rng.random(steps.size) < model.reading(world.target[steps])
            observations.append(Observation(path, True, reading.astype(np.int8)))
        else:
            observations.append(Observation(path, False))
        estimator.assimilate(observations[-1])
    return observations


STUDIES = {each.__name__: each for each in (numbers, coverage, missions, rates, kinds, check)}


def run_world(study: str, seed: int) -> list[dict]:
    return [{'world': seed, **row} for row in STUDIES[study](seed)]


def summary(path: Path) -> None:
    """Print the mean of each quantity, and paired differences to a case's last estimator."""
    table = pd.read_csv(path)
    for case, of_case in table.groupby('case', sort=False):
        print(f'{case}: {of_case.world.nunique()} worlds')
        for quantity in table.columns.drop(['world', 'case', 'estimator']):
            wide = of_case.pivot(index='world', columns='estimator', values=quantity)
            wide = wide.dropna(axis='columns', how='all')
            for name in wide:
                mean, error = wide[name].mean(), wide[name].sem()
                print(f'  {quantity} {name}: {mean:.3f} +- {error:.3f}')
            reference = next((n for n in ('told', 'kappa_bnitp_sampled') if n in wide), None)
            if reference is None or quantity == 'holds':
                continue
            for name in wide.columns.drop(reference):
                less = (wide[name] - wide[reference]).dropna()
                print(f'  {quantity} {name} - {reference}: {less.mean():+.3f} +- {less.sem():.3f}')


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('study', choices=[*STUDIES, 'summary'])
    parser.add_argument('file', nargs='?', type=Path)
    parser.add_argument('--worlds', type=int, default=40)
    parser.add_argument('--workers', type=int, default=os.cpu_count())
    parser.add_argument('--out', type=Path)
    given = parser.parse_args()
    if given.study == 'summary':
        summary(given.file)
        return 0
    done = set(pd.read_csv(given.out).world) if given.out.exists() else set()
    seeds = [seed for seed in range(given.worlds) if seed not in done]
    with ProcessPoolExecutor(given.workers) as pool:
        waiting = [pool.submit(partial(run_world, given.study), seed) for seed in seeds]
        for future in tqdm(as_completed(waiting), total=len(waiting)):
            rows = pd.DataFrame(future.result())
            rows.to_csv(given.out, mode='a', header=not given.out.exists(), index=False)
    return 0


if __name__ == '__main__':
    sys.exit(main())
